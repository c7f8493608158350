"""What image codecs reach under the frozen localizer: error by bytes, and the bytes needed for O-VIB's error."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ovibjax.world.town.coded import Rung

PAPER_LATENCY_S = {"jpeg": 4.58, "webp": 2.92, "h264": 5.04, "h265": 3.61}
"""The paper's latency at 8 KB/s, by codec."""

RIVAL_K = 32
"""Prefix of O-VIB that the codecs are compared with."""


@dataclass(frozen=True)
class Frontier:
    """Errors and payloads of R rungs on S seeds.

    Attributes:
        rungs: codecs and qualities.
        seeds: the seeds.
        payload_bytes: [S, R] mean over test frames.
        error_m: [S, R, T] error per coded test frame.
        plain_m: [S] mean error of the images before coding.
        native_m: [S] mean error of the same frames, as the features that the database and the training were made from.
        whole_m: [S] that of all test frames.
        ovib_m: [S] mean error of O-VIB at k = `RIVAL_K` on all test frames.
        encode_ms: [R] time to encode a frame on this machine.
    """

    rungs: tuple[Rung, ...]
    seeds: tuple[int, ...]
    payload_bytes: NDArray[np.float64]
    error_m: NDArray[np.float32]
    plain_m: NDArray[np.float64]
    native_m: NDArray[np.float64]
    whole_m: NDArray[np.float64]
    ovib_m: NDArray[np.float64]
    encode_ms: NDArray[np.float64]

    @property
    def codecs(self) -> tuple[str, ...]:
        """Codecs in the order of the rungs."""
        return tuple(dict.fromkeys(codec for codec, _ in self.rungs))

    @property
    def missed(self) -> str:
        """What so few frames do not show: by the rule of three, a failure that none of n has may befall 3 in n."""
        count = self.error_m.shape[0] * self.error_m.shape[2]
        return f"{count} frames were coded, and failures on fewer than one in {max(count // 3, 1)} may be missed"

    @property
    def mean_m(self) -> NDArray[np.float64]:
        """[S, R] mean errors over all test frames, of which few are coded: uncompressed, plus what coding adds."""
        added_m = self.error_m.mean(axis=2, dtype=np.float64) - self.native_m[:, None]
        # Few frames can also say that coding helps by more than there is to gain.
        return np.maximum(self.whole_m[:, None] + added_m, 0.0)

    def of(self, codec: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Payloads [S, r] in bytes and mean errors [S, r] in metres of one codec's rungs."""
        mine = self._rungs_of(codec)
        return self.payload_bytes[:, mine], self.mean_m[:, mine]

    def _rungs_of(self, codec: str) -> list[int]:
        return [i for i, (name, _) in enumerate(self.rungs) if name == codec]

    def equal_error_bytes(self, codec: str) -> NDArray[np.float64]:
        """[S] fewest bytes at which the codec reaches O-VIB's error; infinite where no quality does."""
        return np.array(
            [fewest_bytes(*rows, self.ovib_m[i]) for i, rows in enumerate(zip(*self.of(codec), strict=True))]
        )

    def equal_error_encode_ms(self, codec: str) -> NDArray[np.float64]:
        """[S] time to encode at the first quality that reaches O-VIB's error; infinite where none does."""
        encode_ms = self.encode_ms[self._rungs_of(codec)]
        first = [first_reached(errors, self.ovib_m[i]) for i, errors in enumerate(self.of(codec)[1])]
        return np.array([float("inf") if rung is None else encode_ms[rung] for rung in first])

    def latency_ms(self, codec: str, rate_bps: float) -> NDArray[np.float64]:
        """[S] encoding and transmission at O-VIB's error; infinite where no quality reaches it."""
        return self.equal_error_encode_ms(codec) + 8e3 * self.equal_error_bytes(codec) / rate_bps

    def coarsest_suffices(self, codec: str) -> bool:
        """Whether the codec's coarsest quality reaches O-VIB's error on every seed: a coarser one might, too."""
        return bool((self.of(codec)[1][:, 0] <= self.ovib_m).all())

    def table_rows(self) -> list[dict[str, Any]]:
        """One tidy row per codec, quality and seed: the mean of all test frames, the percentile of the coded ones."""
        rows = []
        for r, (codec, quality) in enumerate(self.rungs):
            for s, seed in enumerate(self.seeds):
                row = {"codec": codec, "quality": quality, "seed": seed}
                row |= {"payload_bytes": f"{self.payload_bytes[s, r]:.1f}", "mean_m": f"{self.mean_m[s, r]:.4f}"}
                row |= {"p90_m": f"{np.percentile(self.error_m[s, r], 90):.4f}"}
                rows.append(row | {"encode_ms": f"{self.encode_ms[r]:.2f}"})
        return rows


def first_reached(error_m: NDArray[np.float64], target_m: float) -> int | None:
    """Position in a ladder of errors [r] of the first that is at most a target; None if none is."""
    reached = np.flatnonzero(error_m <= target_m)
    return int(reached[0]) if reached.size else None


def fewest_bytes(payload_bytes: NDArray[np.float64], error_m: NDArray[np.float64], target_m: float) -> float:
    """Payload at which a rising ladder first reaches an error: between two rungs, linear in the logarithm of bytes.

    Args:
        payload_bytes: [r] increasing.
        error_m: [r] mean errors.
        target_m: the error to reach.

    Returns:
        Bytes; the lowest rung's if that already reaches it, infinite if none does.
    """
    i = first_reached(error_m, target_m)
    if i is None:
        return float("inf")
    if i == 0:
        return float(payload_bytes[0])
    share = (error_m[i - 1] - target_m) / (error_m[i - 1] - error_m[i])
    low, high = np.log(payload_bytes[i - 1 : i + 1])
    return float(np.exp(low + share * (high - low)))
