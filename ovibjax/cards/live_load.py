"""Requests that robots sent in replays of their routes, and loads of them for live edges: the same under every rule."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ovibjax.control.route_replay import replay_draws
from ovibjax.errors import InputError
from ovibjax.link.latency import JETSON, compute_ms_at, kbytes_per_s, transmit_s
from ovibjax.link.payload import Request, pack
from ovibjax.live.edge_file import EdgeFile
from ovibjax.live.messages import RobotState, pack_request
from ovibjax.live.open_loop import Load
from ovibjax.live.robot_process import RobotJob, robot_of, world_of

_SEQUENCES = 4096  # apart, so that no two loads of a study draw the same service times


class Recorded(NamedTuple):
    """A request of a robot's replay, but for the number that it is sent under.

    Attributes:
        mode: a key of `views.MODES`.
        prefix: [k] of the frame's code.
        voi_m: predicted net VOI.
        state: risk, drift, predicted delay, urgency.
        deadline_ms: relative deadline.
        uplink_ms: encoding on the robot and transmission, which a load waits for.
    """

    mode: str
    prefix: npt.NDArray[np.float32]
    voi_m: float
    state: RobotState
    deadline_ms: int
    uplink_ms: float


class OfferedLoad(NamedTuple):
    """A load, and what its requests had behind them when they were due.

    Attributes:
        load: the requests.
        uplink_ms: [J] encoding and transmission.
        mode: [J] view mode of each.
    """

    load: Load
    uplink_ms: npt.NDArray[np.float64]
    mode: list[str]


def recorded_requests(job: RobotJob, file: EdgeFile) -> list[list[Recorded]]:
    """Replay the routes of a job's robots, and encode what each of them sends.

    Args:
        job: the job; nobody listens at its port.
        file: the edge file.

    Returns:
        Requests by robot, in the order of time; robots that send nothing are left out.

    Raises:
        InputError: no robot sends anything.
    """
    world, actions = world_of(job, file), file.actions
    found = []
    for number in job.clients:
        robot, mission = robot_of(job, world, number)
        run = replay_draws(robot.draws, robot.route, job.policy, world.params, actions)
        sent, action, voi_m, risk_m, delay_s = (
            np.asarray(leaf) for leaf in (run.sent, run.action, run.voi_m, run.risk_before_m, run.delay_s)
        )
        mine = []
        for slot in np.flatnonzero(sent).tolist():
            a = int(action[slot])
            state = RobotState(
                float(risk_m[slot]),
                float(robot.drift_m_per_s[slot]),
                1000.0 * float(delay_s[slot]),
                mission.urgency,
            )
            deadline_ms = int(np.clip(mission.deadlines_ms[slot], 1, 65535))
            mode, code = actions.modes[a // len(actions.prefixes)], robot.encoded(slot, a)
            uplink_ms = _uplink_ms(len(code), float(actions.payload_bytes[a]), job.profile_kb_per_s)
            mine.append(Recorded(mode, code, float(voi_m[slot]), state, deadline_ms, uplink_ms))
        found.append(mine)
    if not any(found):
        raise InputError(f"policy {job.policy} sends no request on these routes, so that there is nothing to serve")
    return [mine for mine in found if mine]


def _uplink_ms(k: int, payload_bytes: float, rate_kb_per_s: float) -> float:
    """Encoding as the paper's robots do it, and transmission at a constant rate."""
    return float(compute_ms_at(JETSON, k)) + 1000.0 * float(transmit_s(payload_bytes, kbytes_per_s(rate_kb_per_s)))


def poisson_load(
    seed: Sequence[int], recorded: Sequence[Sequence[Recorded]], per_s: float, seconds: float, number: int
) -> OfferedLoad:
    """Requests of all clients at random times: each is observed, encoded, sent, and then due at the edge.

    Args:
        seed: whole numbers.
        recorded: what each client asks, again and again from a place on.
        per_s: how many requests are observed in a second, on average.
        seconds: how long; the number of requests is the product of both.
        number: of this load; numbers of requests, and with them service times, differ from those of other loads.

    Returns:
        The load.
    """
    rng = np.random.default_rng(list(seed))
    count = max(1, round(per_s * seconds))
    seen_s = np.cumsum(rng.exponential(1.0 / per_s, count))
    client = rng.integers(len(recorded), size=count)
    turn = rng.integers(1 << 16, size=len(recorded))
    taken = []
    for c in client.tolist():
        taken.append(recorded[c][turn[c] % len(recorded[c])])
        turn[c] += 1
    return _made(client, 1000.0 * seen_s, taken, recorded, number)


def all_at_once(recorded: Sequence[Sequence[Recorded]], count: int, number: int) -> OfferedLoad:
    """Requests that are all due at the beginning, client after client in turn: what an edge takes for a request."""
    client = np.arange(count) % len(recorded)
    taken = [recorded[c][(j // len(recorded)) % len(recorded[c])] for j, c in enumerate(client.tolist())]
    return _made(client, -np.array([one.uplink_ms for one in taken]), taken, recorded, number)


def _made(
    client: npt.NDArray[np.int64],
    seen_ms: npt.NDArray[np.float64],
    taken: Sequence[Recorded],
    recorded: Sequence[Sequence[Recorded]],
    number: int,
) -> OfferedLoad:
    """Requests in the order in which they are due, numbered by client, as bytes."""
    uplink_ms = np.array([one.uplink_ms for one in taken])
    order = np.argsort(seen_ms + uplink_ms, kind="stable")
    first = number * _SEQUENCES % 65536
    following = np.full(len(recorded), first)
    sequence = np.zeros(len(order), np.int64)
    for place, j in enumerate(order.tolist()):
        following[client[j]] += 1
        sequence[place] = following[client[j]] % 65536
    client, ordered = client[order].astype(np.int64), [taken[j] for j in order.tolist()]
    bodies = [_body(*row) for row in zip(ordered, client.tolist(), sequence.tolist(), strict=True)]
    warm = {c: _body(mine[0], c, first) for c, mine in enumerate(recorded)}
    load = Load(client, sequence, (seen_ms + uplink_ms)[order] / 1000.0, bodies, warm)
    return OfferedLoad(load, uplink_ms[order], [one.mode for one in ordered])


def _body(one: Recorded, client: int, sequence: int) -> bytes:
    packet = pack(Request(one.mode, one.prefix.tolist(), one.voi_m, one.deadline_ms, client, sequence))
    return pack_request(packet, one.state)
