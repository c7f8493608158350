"""The embedded town as a picture: a plan with the drive of the default data, and five views per context."""

import io
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import EllipseCollection, LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from ovibjax.errors import StrPath, refusal
from ovibjax.features.frames import CONTEXTS
from ovibjax.views import VIEWS
from ovibjax.world.town.feature_set import PAPER_FRAMES
from ovibjax.world.town.files import check_seeds, write_whole
from ovibjax.world.town.layout import Town, TownConfig, make_town
from ovibjax.world.town.render import Views, render_frames
from ovibjax.world.town.route import Route, context_labels, make_route
from ovibjax.world.town.shading import SEMANTIC_CLASSES

CONTEXT_COLOURS = ("#0072B2", "#E69F00", "#CC79A7")
"""Colours of the contexts, from Okabe and Ito's palette: told apart with any colour vision."""

_CANDIDATES = 6  # places looked at per context before one is shown
_INK = "#222222"
# Layout of the picture in pixels.
_CELL_W, _CELL_H, _GAP, _MARGIN, _HEADER, _LABEL = 236, 177, 6, 14, 40, 44


def contact_sheet(town_config: TownConfig, path: StrPath, seed: int = 0) -> None:
    """Write one picture of the town: a plan with the drive of the default data, and five views per context.

    Args:
        town_config: the town.
        path: the PNG file to write or replace; its folder must exist.
        seed: the drive, not negative.

    Raises:
        InputError: the file cannot be written, or a seed is out of range.
    """
    path = Path(path)
    check_seeds(path, town_config, seed)
    if path.is_dir() or not path.parent.is_dir():
        raise refusal(path, "cannot be written: name a file in a folder that exists")
    town = make_town(town_config)
    route = make_route(town, town_config, PAPER_FRAMES, seed)
    context = context_labels(town, route.positions_m)
    plan = 3 * _CELL_H + 2 * _GAP
    left = 2 * _MARGIN + plan + _LABEL
    width, height = left + 5 * (_CELL_W + _GAP) - _GAP + _MARGIN, _HEADER + plan + _MARGIN
    figure = Figure(figsize=(width / 100, height / 100), dpi=100)

    def axes_at(x: float, y: float, w: float, h: float) -> Axes:
        """Axes whose top left corner lies x, y pixels from that of the picture."""
        axes = figure.add_axes((x / width, 1 - (y + h) / height, w / width, h / height), xticks=[], yticks=[])
        axes.spines[:].set(color="#999999", linewidth=0.8)
        return axes

    def write_text(x: float, y: float, text: str, **style: Any) -> None:
        figure.text(x / width, 1 - y / height, text, size=16, color=_INK, ha="center", va="center", **style)

    axes = axes_at(_MARGIN, _HEADER, plan, plan)
    _draw_plan(axes, town, route, context, half_m=0.6 * town_config.size_m)
    style = f", style {town_config.style}" if town_config.style else ""
    write_text(_MARGIN + plan / 2, _HEADER / 2, f"Embedded town, seed {town_config.seed}{style}")
    for column, view in enumerate(VIEWS):
        write_text(left + column * (_CELL_W + _GAP) + _CELL_W / 2, _HEADER / 2, view)
    for row, (frame, views) in enumerate(_pick_frames(town, route, context)):
        y, code = _HEADER + row * (_CELL_H + _GAP), int(context[frame])
        _draw_pose(axes, route, frame, CONTEXT_COLOURS[code])
        write_text(left - 28, y + _CELL_H / 2, CONTEXTS[code], rotation=90)
        axes_at(left - 13, y, 7, _CELL_H).set(facecolor=CONTEXT_COLOURS[code])
        for column in range(len(VIEWS)):
            axes_at(left + column * (_CELL_W + _GAP), y, _CELL_W, _CELL_H).imshow(views.rgb[column], aspect="auto")
    stream = io.BytesIO()
    FigureCanvasAgg(figure).print_png(stream)
    try:
        write_whole(path, stream.getvalue())
    except OSError as error:
        raise refusal(path, f"cannot be written ({error.strerror or error})") from error


def _pick_frames(town: Town, route: Route, context: NDArray[np.int32]) -> list[tuple[int, Views]]:
    """One frame per context that occurs: the middle of a long stretch, of several the one of most contrast."""
    edges = np.flatnonzero(np.diff(context, prepend=-1, append=-1))
    starts, stops = edges[:-1], edges[1:]
    shown = []
    for code in range(len(CONTEXTS)):
        mine = np.flatnonzero(context[starts] == code)
        longest = mine[np.argsort(starts[mine] - stops[mine], kind="stable")][:_CANDIDATES]
        seen = list(render_frames(town, route, (starts[longest] + stops[longest]) // 2))
        if seen:
            shown.append(max(seen, key=lambda item: _contrast(item[1])))
    return shown


def _contrast(views: Views) -> float:
    """Spread of the colours below the sky, as a geometric mean: one view onto a bare wall spoils a row."""
    spread = []
    for rgb, semantic in zip(np.asarray(views.rgb), np.asarray(views.semantic), strict=True):
        below = rgb[semantic != SEMANTIC_CLASSES.index("sky")]
        spread.append(below.std(axis=0).mean() if len(below) else 0.0)
    return float(np.prod(spread))


def _draw_plan(axes: Axes, town: Town, route: Route, context: NDArray[np.int32], half_m: float) -> None:
    """The town from above, north up, with the drive in the colours of its contexts."""
    axes.set(xlim=(-half_m, half_m), ylim=(-half_m, half_m), facecolor="#f1ede4")
    edges_x, edges_y = (np.array([-2 * half_m, *lines, 2 * half_m]) for lines in (town.road_x_m, town.road_y_m))
    for i, j in np.argwhere(town.lawn > 0.5):
        lawn = Rectangle((edges_x[i], edges_y[j]), np.diff(edges_x)[i], np.diff(edges_y)[j])
        lawn.set(facecolor="#dbe7cb", linewidth=0)
        axes.add_patch(lawn)
    for margin_m, colour in ((float(town.pavement_m), "#d9d5cc"), (0.0, "#ffffff")):
        reach = float(town.road_half_width_m) + margin_m
        for span, lines in ((axes.axvspan, town.road_x_m), (axes.axhspan, town.road_y_m)):
            for at in lines.tolist():
                span(at - reach, at + reach, color=colour, linewidth=0)
    # Lower storeys first, the higher the darker.
    boxes = town.boxes[np.argsort(town.boxes[:, 5], kind="stable")]
    grey = 0.86 - 0.5 * np.minimum(boxes[:, 5] / 40.0, 1.0)
    outlines = list(boxes[:, [0, 1, 3, 1, 3, 4, 0, 4]].reshape(-1, 4, 2))
    axes.add_collection(PolyCollection(outlines, facecolors=grey.astype(str), edgecolors="#ffffff", linewidths=0.3))
    width = 2 * town.trees[:, 3]
    crowns = EllipseCollection(width, width, np.zeros_like(width), units="xy", offsets=town.trees[:, :2])
    crowns.set(offset_transform=axes.transData, facecolor="#8fae74", linewidth=0)
    axes.add_collection(crowns)
    xy = route.positions_m[:, :2]
    colours = [CONTEXT_COLOURS[code] for code in context[:-1].tolist()]
    axes.add_collection(LineCollection(list(np.stack([xy[:-1], xy[1:]], axis=1)), colors=colours, linewidths=1.6))
    _draw_scale_and_north(axes, half_m)


def _draw_scale_and_north(axes: Axes, half_m: float) -> None:
    """Scale bar and north arrow, in the corners outside the outermost roads."""
    edge, bar_m = 0.955 * half_m, 10.0 ** np.floor(np.log10(half_m))
    axes.plot([-edge, bar_m - edge], [-edge, -edge], color=_INK, linewidth=4, solid_capstyle="butt", zorder=5)
    halo = [withStroke(linewidth=4, foreground="#ffffff")]
    note: dict[str, Any] = {"size": 13, "color": _INK, "ha": "center", "zorder": 5, "path_effects": halo}
    axes.text(bar_m / 2 - edge, -0.94 * half_m, f"{bar_m:.0f} m", va="bottom", **note)
    axes.text(edge, 0.79 * half_m, "N", va="top", **note)
    _draw_arrow(axes, (edge, 0.8 * half_m), (edge, edge))


def _draw_pose(axes: Axes, route: Route, frame: int, colour: str) -> None:
    """A dot where a shown frame was taken, with an arrow along its heading."""
    (x, y), yaw = route.positions_m[frame, :2].tolist(), float(route.yaw_rad[frame])
    reach = 0.07 * float(np.ptp(axes.get_xlim()))
    _draw_arrow(axes, (x, y), (x + reach * np.cos(yaw), y + reach * np.sin(yaw)))
    axes.plot(x, y, "o", markersize=15, color=colour, markeredgecolor=_INK, markeredgewidth=2, zorder=6)


def _draw_arrow(axes: Axes, tail: tuple[float, float], tip: tuple[float, float]) -> None:
    style = {"arrowstyle": "-|>", "mutation_scale": 22, "lw": 3, "color": _INK, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", tip, tail, arrowprops=style, zorder=5)
