from .actions import ACTIONS as ACTIONS
from .client_state import ControlParams as ControlParams
from .controller import make_controller as make_controller
from .drives import embedded_drives as embedded_drives
from .environment import Environment as Environment
from .environment import Route as Route
from .environment import make_environment as make_environment
from .policies import POLICIES as POLICIES
from .predictor import fit_predictor as fit_predictor
from .route_replay import replay as replay
from .route_summary import summarize as summarize
from .scene import Scene as Scene
from .scene import make_scene as make_scene
from .voi import Prices as Prices
from .voi import net_voi as net_voi

__all__ = [
    "ACTIONS",
    "POLICIES",
    "ControlParams",
    "Environment",
    "Prices",
    "Route",
    "Scene",
    "embedded_drives",
    "fit_predictor",
    "make_controller",
    "make_environment",
    "make_scene",
    "net_voi",
    "replay",
    "summarize",
]
