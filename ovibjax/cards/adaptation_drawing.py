"""Panels about a prior that adapts: errors around the change, what they differ by, bytes, what robots believe."""

from collections.abc import Mapping
from functools import partial

import numpy as np
from matplotlib.axes import Axes

from ovibjax.cards.adaptation_arms import ARMS
from ovibjax.cards.adaptation_claims import CALIBRATED, less_percent
from ovibjax.cards.adaptation_study import WORLDS, AdaptationStudy
from ovibjax.cards.timeline import time_s
from ovibjax.control.actions import ActionSet
from ovibjax.control.environment import SLOT_S
from ovibjax.report import figures as fig
from ovibjax.report import panels
from ovibjax.report.claims import interval

COLOURS = {"static": fig.ORANGE, "reported": fig.BLUE, "innovation": fig.PURPLE, "oracle": fig.GREY}
LABELS = {
    "static": "prior of training",
    "reported": "adapted",
    "innovation": "innovations only",
    "oracle": "true prior",
}
SHORT = {
    "front": "front\nas five",
    "repetitive": "not re-\npetitive",
    "degraded": "de-\ngraded",
    "failing": "failing",
    "unchanged": "un-\nchanged",
}
_WINDOW_S = 120.0


def _minutes(found: AdaptationStudy) -> np.ndarray:
    return time_s(len(found.context)) / 60.0


def _mark_change(ax: Axes, found: AdaptationStudy, world: str) -> None:
    """A line where the world changes, and the limits of the time axis."""
    minutes = _minutes(found)
    if world != "unchanged":
        ax.axvline(minutes[found.slot], color="black", lw=0.9, ls=":")
        ax.annotate(
            "change",
            (minutes[found.slot], 1.0),
            (2, -1),
            ("data", "axes fraction"),
            "offset points",
            fontsize=6,
            va="top",
        )
    ax.set(xlim=(0, minutes[-1]), xlabel="time (min)")


def _draw_error(ax: Axes, found: AdaptationStudy, world: str, legend: bool = False) -> None:
    """Route error, a running mean of two minutes."""
    size = min(round(_WINDOW_S / SLOT_S), found.slot)
    weights, tops = np.ones(size) / size, []
    for arm in ("oracle", "static", "reported"):
        errors = found.arms[CALIBRATED].error_m[ARMS.index(arm), WORLDS.index(world)]
        running = np.array([np.convolve(one, weights, "valid") for one in errors])
        minutes = _minutes(found)[size - 1 :]
        mean, half = fig.mean_and_half(running)
        tops.append(mean.max())
        ax.plot(minutes, mean, color=COLOURS[arm], label=LABELS[arm], ls="--" if arm == "oracle" else "-")
        if arm != "oracle" and len(errors) >= fig.FEWEST_SEEDS:
            ax.fill_between(minutes, mean - half, mean + half, color=COLOURS[arm], alpha=0.15, lw=0)
    _mark_change(ax, found, world)
    ax.set(ylabel="route error (m)", ylim=(0, 1.35 * max(tops)))
    if legend:
        ax.legend(loc="upper right", ncols=3, columnspacing=0.8, handlelength=1.2)


def _draw_differences(ax: Axes, found: AdaptationStudy) -> None:
    series = [
        (LABELS[arm], COLOURS[arm], [less_percent(found, arm, world) for world in WORLDS])
        for arm in ("reported", "oracle", "innovation")
    ]
    panels.columns(ax, [SHORT[world] for world in WORLDS], series)
    ax.axhline(0, color="black", lw=0.7)
    ax.set(ylabel="less error than the\nprior of training (%)", ylim=(-140, 155))
    ax.legend(loc="upper right", ncols=3, columnspacing=0.8, handlelength=1.0)


def _draw_bytes(ax: Axes, found: AdaptationStudy) -> None:
    series = [
        (LABELS[arm], COLOURS[arm], [interval(found.of(arm, world, "kb")) for world in WORLDS])
        for arm in ("static", "reported", "oracle")
    ]
    panels.columns(ax, [SHORT[world] for world in WORLDS], series)
    ax.axhline(found.budget_kb, color="black", lw=0.9, ls="--")
    ax.annotate(
        "budget", (1.0, found.budget_kb), (0, 2), ("axes fraction", "data"), "offset points", ha="right", fontsize=6
    )
    ax.set(ylabel="sent on the drive (KB)", ylim=(0, 1.4 * found.budget_kb))
    ax.legend(loc="upper right", ncols=3, columnspacing=0.8, handlelength=1.0)


def shown_action(actions: ActionSet, world: str) -> int:
    """The action whose belief is drawn: the cheapest where the front view gets better, the richest elsewhere."""
    return 0 if world == "front" else len(actions) - 1


def _draw_belief(ax: Axes, found: AdaptationStudy, world: str) -> None:
    """What robots expect of an action in the most frequent context, and what is true."""
    where = int(np.bincount(found.context).argmax())
    action = shown_action(found.scene.actions, world)
    prior_m = float(found.prior_m[CALIBRATED][where, action])
    place = WORLDS.index(world)
    belief = prior_m * found.arms[CALIBRATED].factor[place, :, :, where, action]
    mean, half = fig.mean_and_half(belief)
    minutes, truth = _minutes(found), found.truth_m[CALIBRATED][place, :, action].copy()
    for part in (slice(None, found.slot), slice(found.slot, None)):
        here = truth[part][found.context[part] == where]
        truth[part] = here[0] if len(here) else np.nan
    ax.plot(minutes, truth, color=COLOURS["oracle"], ls="--", label=LABELS["oracle"])
    ax.axhline(prior_m, color=COLOURS["static"], label=LABELS["static"])
    ax.plot(minutes, mean, color=COLOURS["reported"], label=LABELS["reported"])
    if len(belief) >= fig.FEWEST_SEEDS:
        ax.fill_between(minutes, mean - half, mean + half, color=COLOURS["reported"], alpha=0.2, lw=0)
    _mark_change(ax, found, world)
    ax.set(ylabel=f"expected of {found.scene.actions.names[action]} (m)")
    ax.set_ylim(0, 1.35 * max(prior_m, float(np.nanmax(truth)), float(mean.max())))


PANELS: Mapping[str, panels.Panel] = {
    "front view suddenly as good as five": partial(_draw_error, world="front"),
    "repetitive blocks no longer repetitive": partial(_draw_error, world="repetitive"),
    "backbone degrades": partial(_draw_error, world="degraded"),
    "nothing changes": partial(_draw_error, world="unchanged", legend=True),
    "paired differences": _draw_differences,
    "bytes": _draw_bytes,
    "what robots believe, front view": partial(_draw_belief, world="front"),
    "what robots believe, degraded": partial(_draw_belief, world="degraded"),
}
"""The figure, panel by panel."""
