from . import cards as cards
from . import cli as cli
from . import control as control
from . import edge as edge
from . import encoder as encoder
from . import features as features
from . import link as link
from . import live as live
from . import report as report
from . import runtime as runtime
from . import scheduling as scheduling
from . import sweep as sweep
from . import system as system
from . import views as views
from . import world as world
from .cards.loading import load_features as load_features
from .cards.reproduce import reproduce as reproduce
from .errors import InputError as InputError
from .features.frames import FeatureSet as FeatureSet
from .features.frames import make_feature_set as make_feature_set
from .world.rooms.feature_set import room_features as room_features
from .world.town.feature_set import town_features as town_features

__version__: str

__all__ = [
    "FeatureSet",
    "InputError",
    "cards",
    "cli",
    "control",
    "edge",
    "encoder",
    "features",
    "link",
    "live",
    "load_features",
    "make_feature_set",
    "report",
    "reproduce",
    "room_features",
    "runtime",
    "scheduling",
    "sweep",
    "system",
    "town_features",
    "views",
    "world",
]
