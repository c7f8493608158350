"""Table "Datasets and evaluation configurations": the data that the other figures were made from, in numbers."""

import time
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ovibjax.cards.job import Job
from ovibjax.cards.workloads import sizes_claim, workload_rows, workloads
from ovibjax.features.description import Description, describe
from ovibjax.features.frames import CONTEXTS, FeatureSet
from ovibjax.features.splits import split_indices
from ovibjax.report import figures as fig
from ovibjax.report.claims import HELD, REPORTED, Claim, write_claims
from ovibjax.report.panels import sheet
from ovibjax.report.rows import write_rows
from ovibjax.views import VIEWS
from ovibjax.world.town.layout import TownConfig, make_town
from ovibjax.world.town.picture import CONTEXT_COLOURS
from ovibjax.world.town.render import render_frames
from ovibjax.world.town.route import Route

TITLE = "The data"
MAX_PICTURES = 12
COLOURS = (*CONTEXT_COLOURS, fig.GREY)
NAMES = (*CONTEXTS, "unknown context")
PAPER: dict[str, dict[str, str]] = {
    "Town05": {
        "scenes": "1",
        "frames": "4994",
        "training frames": "3495",
        "validation frames": "749",
        "test frames": "750",
        "views": "5",
        "feature dimension": "512",
    },
    "CARLA UAV": {"scenes": "5", "frames": "6684 raw; 4593 sampled", "views": "5", "feature dimension": "512"},
    "Indoor UGV": {
        "scenes": "1",
        "frames": "78 reference; 72 query",
        "views": "4",
        "feature dimension": "512",
        "width along x": "5.0",
        "width along y": "4.0",
    },
}
"""The paper's settings that a feature set may stand in for."""


def run(job: Job) -> None:
    """Run the card: table, claim, pictures."""
    started = time.perf_counter()
    data = job.features
    split = split_indices(len(data.features), job.seed)
    scenes = np.unique(data.scene_id).tolist()
    whole = describe(data, split)
    setting = setting_of(whole, len(scenes))
    rows = table_rows("all", whole, setting, len(scenes))
    if len(scenes) > 1:
        for scene in scenes:
            rows += table_rows(str(scene), describe(data, split, scene), setting, None)
    write_rows(job.out / "table.csv", rows)
    (job.out / "workloads.csv").unlink(missing_ok=True)  # of an earlier run on the embedded data
    stands_in = workloads(job.seed) if job.embedded else []
    if stands_in:
        write_rows(job.out / "workloads.csv", workload_rows(stands_in))
    claims = [split_claim(whole), *([sizes_claim(stands_in)] if stands_in else [])]
    write_claims(job.out / "claims.json", claims)
    with job.stage("draw"):
        draw(job.out / "figure.png", data, scenes, job.embedded)
    job.record(TITLE, caption(whole, scenes, setting, job.embedded), [job.seed], started, setting=setting)


def setting_of(whole: Description, n_scenes: int) -> str:
    """The paper's data set that comes closest in kind: platform first, then the number of scenes."""
    if whole.views == 4:
        return "Indoor UGV"
    return "Town05" if n_scenes == 1 else "CARLA UAV"


def table_rows(scene: str, what: Description, setting: str, n_scenes: int | None) -> list[dict[str, Any]]:
    """One row per quantity: scene, quantity, unit, ours, the paper's where it gives one for the whole set."""
    values: list[tuple[str, str, str]] = [("scenes", "", str(n_scenes))] if n_scenes is not None else []
    values.append(("frames", "", str(what.frames)))
    for name, count in zip(("training", "validation", "test"), what.parts, strict=True):
        values.append((f"{name} frames", "", str(count)))
    values += [("views", "", str(what.views)), ("feature dimension", "", str(what.dim))]
    lengths = {"route length": what.route_m, "breaks in the route": what.breaks, "spacing of frames": what.spacing_m}
    lengths["test frame to nearest training frame"] = what.nearest_m
    values += [(name, "" if isinstance(length, int) else "m", _length(length)) for name, length in lengths.items()]
    for name, span in zip(("width along x", "width along y", "height range"), what.extent_m, strict=True):
        values.append((name, "m", f"{span:.1f}"))
    values += [(name, "%", f"{100 * share:.1f}") for name, share in zip(NAMES, what.context_share, strict=True)]
    paper = PAPER[setting] if n_scenes is not None else {}
    return [
        {"scene": scene, "quantity": name, "unit": unit, "ours": ours, "paper": paper.get(name, "-")}
        for name, unit, ours in values
    ]


def _length(length: float) -> str:
    """A length in metres, or a count; "-" where there is none."""
    digits = 0 if isinstance(length, int) or length >= 100 else 2
    return f"{length:.{digits}f}" if np.isfinite(length) else "-"


def split_claim(whole: Description) -> Claim:
    """The one statement of the paper's table that data can satisfy or not."""
    parts = [int(PAPER["Town05"][f"{name} frames"]) for name in ("training", "validation", "test")]
    return Claim(
        "The single-scene data have the paper's size and split",
        f"{sum(parts)}; {' / '.join(map(str, parts))}",
        f"{whole.frames}; {' / '.join(map(str, whole.parts))}",
        HELD if list(whole.parts) == parts else REPORTED,
        "held if all sizes are equal; data of another size are reported",
    )


def caption(whole: Description, scenes: list[int], setting: str, embedded: bool) -> str:
    """What the reader of the figure needs to know."""
    shown = f"; the first {MAX_PICTURES} of {len(scenes)} scenes are shown" if len(scenes) > MAX_PICTURES else ""
    views = " Below: the five views at the ringed place." if embedded else ""
    beside = "; workloads.csv sets all seven of its workloads beside the embedded ones" if embedded else ""
    route = "Route length and spacing follow the order within a scene; steps over ten times the median count as breaks."
    order = route if np.isfinite(whole.route_m) else "The frames are places in no order: there is no route."
    return (
        f"Positions of the {whole.frames} frames from above, coloured by context{shown}.{views} The table gives the "
        f"paper's numbers for its set {setting!r}{beside}. {order}"
    )


def draw(path: Path, data: FeatureSet, scenes: list[int], embedded: bool) -> None:
    """A plan per scene; for the embedded town also its views."""
    if embedded:
        _draw_town(path, data)
        return
    shown = scenes[:MAX_PICTURES]
    columns = min(len(shown), 4)
    with sheet(path, columns, -(-len(shown) // columns), height_in=2.3 if columns > 1 else 3.5) as axes:
        for ax, scene in zip(axes, shown, strict=False):
            of_scene = data.scene_id == scene
            _draw_plan(ax, data, of_scene, f"scene {scene}: {int(of_scene.sum())} frames")
        for ax in axes[len(shown) :]:
            ax.set_axis_off()
        handles = _handles(np.unique(data.context % len(NAMES)))
        axes[0].figure.legend(handles=handles, loc="outside lower center", ncols=len(NAMES))


def _draw_plan(ax: Axes, data: FeatureSet, rows: np.ndarray, title: str) -> None:
    x, y = data.positions_m[rows, :2].T
    colours = np.array(COLOURS)[data.context[rows]]  # -1, unknown, is the last
    ax.scatter(x, y, s=3, c=colours, lw=0)
    ax.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    ax.set_title(title, loc="left")


def _handles(codes: np.ndarray) -> list[Line2D]:
    return [Line2D([], [], ls="", marker="o", ms=4, color=COLOURS[code], label=NAMES[code]) for code in codes.tolist()]


def _draw_town(path: Path, data: FeatureSet) -> None:
    """The drive over the town's ground plan, and the five views half-way through its longest open stretch."""
    town = make_town(TownConfig())
    frame = _middle_of_longest(data.context)
    ((_, views),) = render_frames(town, Route(data.positions_m.astype(np.float32), data.yaw_rad), np.array([frame]))
    with mpl.rc_context(fig.style()):
        figure = Figure(figsize=(fig.PAGE_IN, 5.2), layout="constrained")
        FigureCanvasAgg(figure)
        grid = figure.add_gridspec(2, len(VIEWS), height_ratios=(3.4, 1))
        ax = figure.add_subplot(grid[0, :])
        for x0, y0, x1, y1 in town.boxes[:, [0, 1, 3, 4]].tolist():
            ax.fill([x0, x1, x1, x0], [y0, y0, y1, y1], color="#D9D9D9", lw=0)
        _draw_plan(ax, data, np.ones(len(data.context), bool), f"embedded town: {len(data.context)} frames")
        here = data.positions_m[frame]
        ax.plot(here[0], here[1], "o", ms=9, mfc="none", mec="black", mew=1.4)
        ax.legend(handles=_handles(np.unique(data.context % len(NAMES))), loc="center left", bbox_to_anchor=(1.0, 0.5))
        ax.grid(visible=False)
        for column, name in enumerate(VIEWS):
            picture = figure.add_subplot(grid[1, column], xticks=[], yticks=[])
            picture.imshow(np.asarray(views.rgb)[column])
            picture.set_title(name)
        fig.save_figure(figure, path)


def _middle_of_longest(context: np.ndarray) -> int:
    """Middle frame of the longest stretch of one context: away from its edges."""
    edges = np.flatnonzero(np.diff(context, prepend=-2, append=-2))
    longest = int(np.argmax(np.diff(edges)))
    return int(edges[longest : longest + 2].sum() // 2)
