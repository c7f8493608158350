"""What is expected of live edges and robots beside their replay: all of it is ours, the paper measures neither."""

from collections.abc import Callable, Sequence

import numpy as np

from ovibjax.cards.live_runs import Floats, LiveRun
from ovibjax.cards.live_study import LOADS, LiveStudy
from ovibjax.cards.scheduling_drawing import NAMES
from ovibjax.live.log_report import percentile
from ovibjax.report.claims import PAIRED, Claim, interval, near_zero, weakest

TOLERANCE = 0.15
"""How far a replay may be off, as a share of what was measured."""

_SHARE, _HIGH = f"{100 * TOLERANCE:.0f} %", f"{100 * LOADS['high']:.0f} %"
_WITHIN = f"the whole interval over repetitions within {_SHARE} of the live run, under every rule"


def judge_claims(found: LiveStudy) -> list[Claim]:
    """Every claim, in the order of the panels."""
    high = f"at {_HIGH} load"
    given = ", given the times of service and dispatch of the live run"
    return [
        *(_close(found, load, "kept", "all", f"At {100 * LOADS[load]:.0f} % load{given}") for load in LOADS),
        _close(found, "high", "kept", "top10", f"Top decile {high}{given}"),
        _close(found, "high", "service", "all", f"Given the times of service alone, {high}"),
        _close(found, "high", "planned", "all", f"Known before the run, {high}"),
        _lowest(found),
        _missing(found),
        _routes(found),
    ]


def _close(found: LiveStudy, load: str, model: str, scope: str, start: str) -> Claim:
    off = {rule: found.off(load, rule, model, scope) for rule in found.size.rules}
    texts = []
    for rule, values in off.items():
        live = interval(found.p95_ms(load, rule, "live", scope))
        texts.append(f"{NAMES[rule]} {interval(100.0 * values).text('%', 1)} of {live.text('ms', 1)}")
    most = max(abs(interval(100.0 * values).mean) for values in off.values())
    verdict = weakest(near_zero(interval(values), TOLERANCE) for values in off.values())
    statement = f"{start}: the replay's edge p95 is within {_SHARE} of the live one under every rule"
    return Claim(statement, "-", f"{most:.1f} % off at most: {'; '.join(texts)}", verdict, _WITHIN).as_own()


def _lowest(found: LiveStudy) -> Claim:
    order = [rule for rule in NAMES if rule in found.size.rules]
    ours, *rivals = (found.p95_ms("high", rule, "live", "top10") for rule in order)
    texts = [interval(values).text("ms", 1) for values in (ours, *rivals)]
    words = ", ".join(NAMES[rule] for rule in order[1:])
    return Claim.less(
        f"Live at {_HIGH} load, VOI-Lyapunov has the lowest edge p95 of the top decile",
        "-",
        f"{' / '.join(texts)} ({words})",
        *(ours, *rivals),
        rule=f"{PAIRED}, against every other rule on the same requests",
    ).as_own()


def _missing(found: LiveStudy) -> Claim:
    """What a replay of planned times leaves out, from the live runs."""
    high = found.every("high")
    return Claim.reported(
        f"What the replay leaves out of a live edge, per request at {_HIGH} load",
        "-",
        f"dispatch {mean_of(high, lambda run: run.parts['dispatch'])}; service longer than planned, as timers tell "
        f"whole milliseconds, {mean_of(high, lambda run: run.service_ms - run.planned_ms)}; request to the edge's note "
        f"of it {mean_of(high, lambda run: run.noticed_ms)}, of which the load generator was late by "
        f"{mean_of(high, lambda run: run.late_ms)} (p99 {_worst(high):.1f} ms)",
        "means over runs of all rules",
    ).as_own()


def mean_of(runs: Sequence[LiveRun], what: Callable[[LiveRun], Floats]) -> str:
    """Mean over runs of the mean of a time per request, with its interval, in ms."""
    return interval([float(np.mean(what(run))) for run in runs]).text("ms")


def _worst(runs: Sequence[LiveRun]) -> float:
    return float(np.percentile(np.concatenate([run.late_ms for run in runs]), 99))


def _routes(found: LiveStudy) -> Claim:
    routes = found.routes
    live_m, given_m, assumed_m = (
        error_m.mean(axis=1) for error_m in (routes.live_m, routes.given.error_m, routes.assumed.error_m)
    )
    ended = ", ".join(f"{count} {status}" for status, count in routes.ended.most_common()) or "none"
    return Claim.within(
        f"Given the median wait at the live edge, robots have the route error of their replay within {_SHARE}",
        "-",
        f"{interval(live_m).text('m')} live, {interval(given_m).text('m')} replayed, difference "
        f"{interval(live_m - given_m).text('m')}; with the {routes.assumed.wait_ms:.0f} ms that the replay assumes in "
        f"place of {routes.wait_ms:.1f}, {interval(live_m - assumed_m).text('m')}; questions live: {ended}, replayed: "
        f"{len(routes.given.latency_ms)}, {len(routes.assumed.latency_ms)}; decision to answer p95 "
        f"{routes.e2e_p95_ms:.0f} ms live, {percentile(routes.given.latency_ms, 95):.0f} and "
        f"{percentile(routes.assumed.latency_ms, 95):.0f} ms replayed",
        TOLERANCE,
        (live_m - given_m) / given_m.mean(),
        rule="the whole interval of the paired difference over robots within that share of the replay's mean",
    ).as_own()
