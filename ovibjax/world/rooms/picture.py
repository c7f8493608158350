"""The embedded rooms as a picture: plan with both drives, and the views of one frame."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ovibjax.views import VIEWS
from ovibjax.world.rooms.drive import query_drive, reference_drive
from ovibjax.world.rooms.furniture import KINDS
from ovibjax.world.rooms.interior import render_interior
from ovibjax.world.rooms.room import Room, RoomConfig, make_room

_HEIGHT_PX, _WIDTH_PX = 180, 240


def draw_plan(ax: Axes, room: Room) -> None:
    """Walls, furniture and rug from above; the axes in metres.

    Args:
        ax: the panel.
        room: the room.
    """
    half = room.size_m[:2] / 2
    ax.add_patch(Rectangle((-half[0], -half[1]), *(2 * half), fc="#F4F1EA", ec="#444444", lw=1.4, zorder=0))
    for row in room.decor[(room.decor[:, 0] == 4) & (room.decor[:, 8] == KINDS.index("rug"))]:
        ax.add_patch(Rectangle(row[1:3], *(row[3:5] - row[1:3]), fc="#E3DCEB", ec="none", zorder=1))
    floor_boxes = room.boxes[(room.boxes[:, 0] < 900) & (room.boxes[:, 2] < 1.0)]
    for row in floor_boxes:
        shade = str(round(0.85 - 0.2 * min(float(row[5]), 2.0), 2))
        ax.add_patch(Rectangle(row[:2], *(row[3:5] - row[:2]), fc=shade, ec="#777777", lw=0.4, zorder=2))
    ax.set(xlim=(-half[0] - 0.1, half[0] + 0.1), ylim=(-half[1] - 0.1, half[1] + 0.1), aspect="equal")
    ax.grid(visible=False)


def room_sheet(rooms: Sequence[tuple[str, RoomConfig]], path: Path) -> None:
    """Draw rooms, one row each: a plan with both drives, and the views of a frame in the middle of the reference drive.

    Args:
        rooms: heading and description of each.
        path: the PNG to write.
    """
    columns = 1 + max(config.n_views for _, config in rooms)
    with mpl.rc_context({"font.size": 9}):
        figure = Figure(figsize=(2.2 * columns, 1.85 * len(rooms)), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(len(rooms), columns, squeeze=False)
        for line, (name, config) in zip(axes, rooms, strict=True):
            room = make_room(config)
            drives = reference_drive(room, config), query_drive(room, config)
            draw_plan(line[0], room)
            for drive, colour in zip(drives, ("#0072B2", "#E69F00"), strict=True):
                line[0].plot(*drive.positions_m[:, :2].T, ".", ms=3, color=colour, zorder=3)
            line[0].set_ylabel(name)
            frame = config.references // 2
            at = (drives[0].origin_m[frame], drives[0].view_yaw_rad[frame], drives[0].view_pitch_rad[frame])
            rgb = np.asarray(render_interior(room, *at, _HEIGHT_PX, _WIDTH_PX)[0])
            x, y = drives[0].positions_m[frame, :2]
            line[0].plot(x, y, "o", ms=6, mfc="none", color="black", zorder=4)
            for view, ax in enumerate(line[1:]):
                if view < config.n_views:
                    ax.imshow(rgb[view], interpolation="lanczos")
                ax.axis("off")
            line[0].set(xticks=[], yticks=[])
        for ax, text in zip(axes[0], ("references, queries", *VIEWS), strict=False):
            ax.set_title(text, fontsize=9)
        figure.savefig(path, dpi=110)
