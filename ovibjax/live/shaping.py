"""An uplink as slow as a wireless one: a token bucket whose rate changes from slot to slot.

With an empty bucket (depth 0, the default) it is a serial link: a message takes its size over the rate, and waits for
those before it. A deeper bucket lets so many bytes pass at once after a pause.
"""

import math

import numpy as np
import numpy.typing as npt

_BITS = 8


class TokenBucket:
    """When bytes that are sent will have left.

    Args:
        rate_bps: [T] rate of each slot, bits per second, zero or more; the last one stays.
        slot_s: length of a slot.
        depth_bytes: what may pass at once after a pause.
    """

    def __init__(self, rate_bps: npt.ArrayLike, slot_s: float, depth_bytes: float = 0.0) -> None:
        self._rate_bps = np.asarray(rate_bps, np.float64)
        self._slot_s, self._depth_bits = slot_s, _BITS * depth_bytes
        self._edges_bits = np.concatenate([[0.0], np.cumsum(self._rate_bps * slot_s)])
        self._spent_bits = -self._depth_bits  # on the scale of the link's own total

    def leaves_s(self, now_s: float, size_bytes: int) -> float:
        """Send bytes.

        Args:
            now_s: when, from the start of the first slot; not before the last call.
            size_bytes: how many.

        Returns:
            When the last of them will have left; infinity where the link stays down.
        """
        # Tokens that are not used are kept up to the depth of the bucket.
        self._spent_bits = max(self._spent_bits, self._offered_bits(now_s) - self._depth_bits) + _BITS * size_bytes
        return max(now_s, self._when_s(self._spent_bits))

    def _offered_bits(self, at_s: float) -> float:
        """What the link could have sent by a time."""
        slot = min(int(at_s / self._slot_s), len(self._rate_bps) - 1)
        return float(self._edges_bits[slot] + self._rate_bps[slot] * (at_s - slot * self._slot_s))

    def _when_s(self, bits: float) -> float:
        """When it can have sent so many."""
        slot = min(int(np.searchsorted(self._edges_bits, bits, "left")), len(self._rate_bps)) - 1
        slot, left = max(slot, 0), bits - self._edges_bits[max(slot, 0)]
        if left <= 0:
            return slot * self._slot_s
        rate_bps = self._rate_bps[slot]
        return slot * self._slot_s + (left / rate_bps if rate_bps > 0 else math.inf)
