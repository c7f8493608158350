"""The requests that wait at an edge, and which of them is served next: by the rules of the replay, the same functions.

What a rule sees is a `Queue` of fixed width, so that choosing is compiled once per width; times count back from now.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.scheduling.requests import NEVER, Requests
from ovibjax.scheduling.rules import BY_CLIENT, RULES, Queue, SchedulerParams
from ovibjax.scheduling.ties import served_first

WIDTHS = (8, 64, 512, 4096)
"""Widths that choosing is compiled for."""

_TICKS_PER_MS = 1024.0
_LONGEST_MS = 1e6  # a quarter of an hour, in int32 ticks

_COLUMNS = (
    *("age_ms", "deadline_ms", "service_est_ms", "voi_m", "drift_m_per_s", "risk_m", "delay_est_ms", "urgency"),
    *("client", "due", "head", "backlog"),
)


class Ask(NamedTuple):
    """What scheduling knows of a request.

    Attributes:
        client: number of its client.
        ready_s: when it arrived, on the edge's clock.
        deadline_ms: relative deadline, positive.
        service_est_ms: estimated service time, positive.
        voi_m: predicted net VOI.
        drift_m_per_s: fitted drift rate.
        risk_m: local risk.
        delay_est_ms: predicted latency.
        urgency: mission urgency, positive.
    """

    client: int
    ready_s: float
    deadline_ms: float
    service_est_ms: float
    voi_m: float
    drift_m_per_s: float
    risk_m: float
    delay_est_ms: float
    urgency: float


class WaitingRoom:
    """Requests in the order of their arrival, each with whatever its owner wants back.

    Attributes:
        rule: one of `scheduling.rules.POLICIES`.
        params: numbers of the rules.
    """

    def __init__(self, rule: str, params: SchedulerParams) -> None:
        self.rule, self.params = rule, params
        self._owners: list[Any] = []
        self._asks = np.empty((WIDTHS[-1], len(Ask._fields)))

    def __len__(self) -> int:
        return len(self._owners)

    @property
    def full(self) -> bool:
        """Whether no more requests may wait."""
        return len(self._owners) >= WIDTHS[-1]

    @property
    def owners(self) -> list[Any]:
        """Owners of the requests that wait, in the order of arrival."""
        return list(self._owners)

    @property
    def backlog_ms(self) -> float:
        """Predicted work that waits."""
        return float(self._column("service_est_ms").sum())

    @property
    def since_s(self) -> float:
        """When the first of those that wait arrived."""
        return float(self._column("ready_s")[0])

    def add(self, ask: Ask, owner: Any) -> None:
        """Let a request wait; raises `OverflowError` where the room is full."""
        if self.full:
            raise OverflowError("the waiting room is full")
        self._asks[len(self._owners)] = ask
        self._owners.append(owner)

    def overdue(self, now_s: float) -> list[Any]:
        """Take out the requests whose deadline has passed: their owners, the latest arrival first."""
        age_ms = 1000.0 * (now_s - self._column("ready_s"))
        return [self._take(int(at)) for at in np.flatnonzero(age_ms > self._column("deadline_ms"))[::-1]]

    def leave(self, owner: Any) -> None:
        """Take out one owner's request, which need not be there any more."""
        if owner in self._owners:
            self._take(self._owners.index(owner))

    def next(self, now_s: float) -> Any:
        """Take out the request that the rule serves next.

        Args:
            now_s: the edge's clock, not before any arrival.

        Returns:
            Its owner.
        """
        count = len(self._owners)
        if count == 1 or self.rule == "fifo":
            # As in the replay, no search; the rows are in the order of arrival.
            return self._take(0)
        width = next(width for width in WIDTHS if width >= count)
        at = _choose(self._seen(now_s, width), np.int32(count), self.params, self.rule)
        return self._take(int(at))

    def warm_up(self) -> None:
        """Compile choosing."""
        for width in WIDTHS:
            _choose(np.ones((len(_COLUMNS), width), np.float32), np.int32(1), self.params, self.rule)

    def _column(self, name: str) -> np.ndarray:
        return self._asks[: len(self._owners), Ask._fields.index(name)]

    def _take(self, at: int) -> Any:
        count = len(self._owners)
        self._asks[at : count - 1] = self._asks[at + 1 : count]
        return self._owners.pop(at)

    def _seen(self, now_s: float, width: int) -> np.ndarray:
        """[columns, width] what the rule looks at, of requests that wait in the order of arrival, then padding."""
        count = len(self._owners)
        ready_s, deadline_ms = self._column("ready_s"), self._column("deadline_ms")
        # Places instead of times: float32 would make deadlines equal that are not.
        due = np.unique(1000.0 * ready_s + deadline_ms, return_inverse=True)[1]
        head, backlog = np.zeros(count), np.zeros(count)
        if self.rule in BY_CLIENT:
            _, first, inverse, counts = np.unique(self._column("client"), True, True, True)
            head[first], backlog[:] = 1.0, counts[inverse]
        computed = {"age_ms": 1000.0 * (now_s - ready_s), "due": due, "head": head, "backlog": backlog}
        table = np.ones((len(_COLUMNS), width), np.float32)
        for row, name in zip(table, _COLUMNS, strict=True):
            row[:count] = computed[name] if name in computed else self._column(name)
        return table


@partial(jax.jit, static_argnames="rule")
def _choose(table: jax.Array, count: jax.Array, params: SchedulerParams, rule: str) -> jax.Array:
    """Column of the table that is served next."""
    row = dict(zip(_COLUMNS, table, strict=True))
    place = jnp.arange(table.shape[1], dtype=jnp.int32)
    waiting = place < count
    ready = (-_TICKS_PER_MS * jnp.clip(row["age_ms"], 0.0, _LONGEST_MS)).astype(jnp.int32)
    client = row["client"].astype(jnp.int32)
    requests = Requests(
        position=place,
        valid=waiting,
        client=client,
        ready=jnp.where(waiting, ready, NEVER),
        service=jnp.zeros_like(place),
        slack=(row["deadline_ms"] - row["service_est_ms"]) * _TICKS_PER_MS,
        per_deadline=1.0 / (row["deadline_ms"] * _TICKS_PER_MS),
        service_est_ms=row["service_est_ms"],
        due=row["due"],
        voi_m=row["voi_m"],
        drift_m_per_s=row["drift_m_per_s"],
        risk_m=row["risk_m"],
        delay_est_ms=row["delay_est_ms"],
        urgency=row["urgency"],
        previous=jnp.full_like(place, -1),
        group=place,
        total=count,
        tick_ms=jnp.float32(1.0 / _TICKS_PER_MS),
    )
    head = waiting & (row["head"] > 0)
    queue = Queue(requests, jnp.int32(0), waiting, head, row["backlog"], place)
    return served_first(RULES[rule](queue, params), client, place, params.ties)
