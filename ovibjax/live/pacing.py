"""How long an edge takes over a request that is to be as slow as another edge: a constant, or the paper's profile.

Decoding and retrieving take a fraction of a millisecond on a processor of today, and 16 ms on the paper's edge
(`edge.service`). What is drawn depends on the request alone, so that it is the same under every rule.
"""

from dataclasses import dataclass

import numpy as np

from ovibjax.edge.service import EDGE
from ovibjax.views import MODES

_COMPUTE_MS = dict(zip(MODES, np.asarray(EDGE.compute_ms).tolist(), strict=True))
_DECODE_MS, _RETRIEVE_MS, _RUNTIME_MS, _JITTER_MS, _SIGMA = (np.asarray(number).item() for number in EDGE[1:])


@dataclass(frozen=True)
class Pace:
    """The least time that requests take.

    Attributes:
        service_ms: of every request.
        paper_speed: how many times as fast as the paper's edge; 0 for none of its times.
    """

    service_ms: float = 0.0
    paper_speed: float = 0.0

    def expected_ms(self, mode: str) -> float:
        """Estimate G of the least time: the paper's expected parts, the jitter at its median.

        Args:
            mode: a key of `views.MODES`.

        Returns:
            Milliseconds.
        """
        return self._at_least(mode, _JITTER_MS)

    def least_ms(self, mode: str, client: int, sequence: int) -> float:
        """Least time of one request: the paper's profile with its lognormal jitter, drawn by the request's number.

        Args:
            mode: a key of `views.MODES`.
            client: number of its client.
            sequence: its sequence number.

        Returns:
            Milliseconds.
        """
        if not self.paper_speed:
            return self.service_ms
        normal = np.random.default_rng((client, sequence)).standard_normal()
        return self._at_least(mode, _JITTER_MS * float(np.exp(_SIGMA * normal)))

    def _at_least(self, mode: str, jitter_ms: float) -> float:
        if not self.paper_speed:
            return self.service_ms
        paper_ms = _COMPUTE_MS[mode] + _DECODE_MS + _RETRIEVE_MS + _RUNTIME_MS + jitter_ms
        return float(max(self.service_ms, paper_ms / self.paper_speed))
