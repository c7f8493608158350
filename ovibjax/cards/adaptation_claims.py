"""What is claimed of a prior that adapts while robots drive; all of it ours, the paper's prior is fitted once."""

import numpy as np

from ovibjax.cards.adaptation_study import WORLDS, AdaptationStudy
from ovibjax.control.changed_worlds import NOISE
from ovibjax.control.predictor import PRIORS
from ovibjax.report.claims import Claim, Interval, interval

MOST_LOSS_PERCENT = 3.0
"""What adaptation may cost where nothing changes."""

MEDIAN, CALIBRATED = PRIORS

WHERE = {
    "front": "Where the front view becomes as good as all views",
    "repetitive": "Where repetitive blocks are answered as corridors",
    "degraded": f"Where features get noise of {NOISE['degraded']:g} of their length",
    "failing": f"Where features get noise of {NOISE['failing']:g} of their length",
    "unchanged": "Where nothing changes",
}
"""How a statement about a world begins."""

_PRIOR = {MEDIAN: "With the paper's median as the prior: ", CALIBRATED: ""}


def judge_claims(found: AdaptationStudy) -> list[Claim]:
    """Claims of every changed world, of the unchanged one, and of what adaptation is made of."""
    changed = WORLDS[:-1]
    claims = [
        *(_better(found, world, CALIBRATED) for world in changed),
        _harmless(found, CALIBRATED),
        *(_bytes(found, world) for world in WORLDS),
        *(_innovation(found, world) for world in WORLDS),
        _probes(found),
        *(_better(found, world, MEDIAN) for world in changed),
        _harmless(found, MEDIAN),
    ]
    return [claim.as_own() for claim in claims]


def less_percent(found: AdaptationStudy, arm: str, world: str, prior: str = CALIBRATED) -> Interval:
    """What an arm takes off the route error of the prior of training, paired, in per cent of its mean."""
    static = found.of("static", world, prior=prior)
    return interval(100.0 * (static - found.of(arm, world, prior=prior)) / static.mean())


def differs(found: AdaptationStudy, world: str) -> bool:
    """Whether a world is another one than the unchanged: a drive without repetitive blocks has none that change."""
    return world == "unchanged" or not np.array_equal(
        *(found.truth_m[CALIBRATED][WORLDS.index(name)] for name in (world, "unchanged"))
    )


def _errors(found: AdaptationStudy, world: str, prior: str, arms: tuple[str, ...]) -> str:
    names = {"static": "prior of training", "reported": "adapted", "oracle": "true prior"}
    return ", ".join(f"{names[arm]} {interval(found.of(arm, world, prior=prior)).text('m')}" for arm in arms)


def _better(found: AdaptationStudy, world: str, prior: str) -> Claim:
    statement = f"{_PRIOR[prior]}{WHERE[world]}, a prior that adapts leads to a lower route error than that of training"
    if not differs(found, world):
        return Claim.silent(statement, "-", "nothing differs on this drive", "the drive has no such place")
    ours = f"{_errors(found, world, prior, ('static', 'reported', 'oracle'))}; "
    ours += f"{less_percent(found, 'reported', world, prior).text('%', 1)} less"
    return Claim.less(
        statement, "-", ours, found.of("reported", world, prior=prior), found.of("static", world, prior=prior)
    )


def _harmless(found: AdaptationStudy, prior: str) -> Claim:
    static, adapted = (found.of(arm, "unchanged", prior=prior) for arm in ("static", "reported"))
    loss = 100.0 * (adapted - static) / static.mean()
    return Claim.at_most(
        f"{_PRIOR[prior]}{WHERE['unchanged']}, adaptation costs less than {MOST_LOSS_PERCENT:g} % of route error",
        "-",
        f"{interval(loss).text('%', 1)} more ({_errors(found, 'unchanged', prior, ('static', 'reported'))})",
        MOST_LOSS_PERCENT,
        loss,
        rule=f"whole 95 % interval of the paired loss at most {MOST_LOSS_PERCENT:g} %",
    )


def _bytes(found: AdaptationStudy, world: str) -> Claim:
    kb = {arm: interval(found.of(arm, world, "kb")).text("KB") for arm in ("static", "reported", "oracle")}
    return Claim.reported(
        f"{WHERE[world]}, what is sent",
        "-",
        f"prior of training {kb['static']}, adapted {kb['reported']}, true prior {kb['oracle']}",
        f"of {found.budget_kb:.1f} KB allowed; prices are the same for all three",
    )


def _innovation(found: AdaptationStudy, world: str) -> Claim:
    return Claim.reported(
        f"{WHERE[world]}, a prior that adapts from innovations alone",
        "-",
        f"takes {less_percent(found, 'innovation', world).text('%', 1)} off the route error of the prior of training; "
        f"from reported risks {less_percent(found, 'reported', world).text('%', 1)}",
        "an answer whose risk is not below the local one is not used, however right it is",
    )


def _probes(found: AdaptationStudy) -> Claim:
    with_them, without = (found.of(arm, "front", "kb") for arm in ("reported", "no_probes"))
    errors = [interval(found.of(arm, "front")).text("m") for arm in ("reported", "no_probes")]
    return Claim.less(
        f"{WHERE['front']}, probes find it: robots with them send less than robots without",
        "-",
        f"{interval(with_them).text('KB')} against {interval(without).text('KB')}, at {errors[0]} and {errors[1]}",
        *(with_them, without),
    )
