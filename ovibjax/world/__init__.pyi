from . import rooms as rooms
from . import town as town
from .rooms.feature_set import room_features as room_features
from .rooms.interior import render_interior as render_interior
from .rooms.room import RoomConfig as RoomConfig
from .rooms.room import make_room as make_room
from .rooms.room import platform_room as platform_room
from .town.feature_set import town_features as town_features
from .town.files import write_frames as write_frames
from .town.layout import TownConfig as TownConfig
from .town.layout import make_town as make_town
from .town.picture import contact_sheet as contact_sheet
from .town.render import Camera as Camera
from .town.render import render as render
from .town.route import context_labels as context_labels
from .town.route import make_route as make_route

__all__ = [
    "Camera",
    "RoomConfig",
    "TownConfig",
    "contact_sheet",
    "context_labels",
    "make_room",
    "make_route",
    "make_town",
    "platform_room",
    "render",
    "render_interior",
    "room_features",
    "rooms",
    "town",
    "town_features",
    "write_frames",
]
