"""A sweep as one web page: best points, every metric to explore, main effects, interactions, configuration."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import xarray as xr

from ovibjax.errors import InputError
from ovibjax.report.best import Choice, choose
from ovibjax.report.claims import Interval
from ovibjax.report.labels import axes_of, find, grid_dims, listing, metrics, text_of, varying, with_unit
from ovibjax.report.main_effects import Effects, effects
from ovibjax.report.means import Over, lacking
from ovibjax.report.web.rendering import render, write
from ovibjax.report.web.studies import studies_of

MOST_METRICS = 12
"""Metrics whose best points and effects are worked out."""


def write_sweep_page(
    dataset: xr.Dataset,
    path: Path,
    title: str,
    metric: str | None = None,
    over: Over = "seed",
    about: Mapping[str, Any] | None = None,
) -> Path:
    """Write a page about a sweep: one file that needs nothing beside it.

    Args:
        dataset: results.
        path: the HTML file.
        title: heading.
        metric: the metric of interest; all by default.
        over: axes to average over.
        about: settings and origin, nested as they come.

    Returns:
        The page's path.

    Raises:
        InputError: an unknown metric or axis, nothing to show or too much, or the page cannot be written.
    """
    names = metrics(dataset) if metric is None else [find(metric, metrics(dataset), "metric")]
    others = [name for name in metrics(dataset) if name not in names]
    dataset = dataset.drop_vars(others)
    studies = [study.packed() for study in studies_of(dataset, over)]
    worked_out = names[:MOST_METRICS]
    lost = {word: int(flag.sum()) for word, flag in lacking(dataset).items()}
    page = render(
        "sweep.html.jinja",
        title=title,
        members=int(dataset["finished"].size),
        lost={word: count for word, count in lost.items() if count},
        axes=[_axis(dataset, axis) for axis in axes_of(dataset)],
        swept=list(axes_of(dataset, grid_dims(dataset))),
        over=[over] if isinstance(over, str) else list(over),
        best=[entry for name in worked_out for entry in _best(dataset, name, over)],
        effects=[(name, with_unit(dataset, name), _shown(effects(dataset, name, over))) for name in worked_out],
        left_out=[*names[MOST_METRICS:], *others],
        studies=studies,
        about=list(_flat(about or {})),
    )
    return write(path, page)


def _axis(dataset: xr.Dataset, axis: str) -> dict[str, Any]:
    values = dataset[axis].values
    return {"name": axis, "unit": dataset[axis].attrs.get("units", ""), "count": len(values), "values": listing(values)}


def _best(dataset: xr.Dataset, metric: str, over: Over) -> list[dict[str, Any]]:
    """The points with the lowest and with the highest mean; nothing where all are equal, or there is no mean."""
    dataset = dataset[[metric, "finished", "diverged"]]
    values, found = dataset[metric].values, []
    if not (values != values.ravel()[0]).any():
        return []
    for word, sign in (("lowest", 1), ("highest", -1)):
        try:
            choice = choose(dataset.assign({metric: sign * dataset[metric]}), metric, (), over)
        except InputError:
            return []
        if choice.points < 2:
            return []
        found.append(_choice(dataset, metric, word, sign, choice))
    return found


def _choice(dataset: xr.Dataset, metric: str, word: str, sign: int, choice: Choice) -> dict[str, Any]:
    second = choice.runner_up
    said = "no other point"
    if second is not None:
        point = _named({axis: value for axis, value in second.point.items() if value != choice.point[axis]})
        tied = f"; {second.tied} of {second.others} other points cannot be told apart" if second.tied else ""
        said = f"{point}: {sign * second.difference.mean:+.3g}"
        said += f" ± {second.difference.cap:.2g}" if second.difference.cap else ""
        said += tied
    return {
        "metric": with_unit(dataset, metric),
        "word": word,
        "span": Interval(sign * choice.means[metric], choice.halves[metric]),
        "point": _named({axis: value for axis, value in choice.point.items() if varying(dataset, axis)}),
        "second": said,
        "missing": choice.missing,
    }


def _named(point: Mapping[str, Any]) -> str:
    return ", ".join(f"{axis} = {text_of(value)}" for axis, value in point.items())


def _shown(found: Effects) -> dict[str, Any]:
    return {
        "levels": found.levels,
        "main": found.main(),
        "pairs": found.interactions(),
        "rest": found.shares.get("rest", 0.0),
        "ranks": found.ranks,
        "complete": found.complete,
    }


def _flat(facts: Any, name: str = "") -> list[tuple[str, str]]:
    """Nested settings as lines: `settings.steps`, `2000`."""
    if isinstance(facts, Mapping):
        return [line for key, value in facts.items() for line in _flat(value, f"{name}.{key}" if name else str(key))]
    if isinstance(facts, list | tuple):
        return [(name, ", ".join(map(str, facts)))]
    return [(name, str(facts))]
