from .clients import default_trace_params as default_trace_params
from .clients import make_trace as make_trace
from .congestion import LEVELS as LEVELS
from .coupled_replay import replay_coupled as replay_coupled
from .events import recorded_events as recorded_events
from .events import synthetic_events as synthetic_events
from .queue_replay import replay as replay
from .replay_grid import run_grid as run_grid
from .replay_metrics import metrics as metrics
from .requests import RequestTrace as RequestTrace
from .rules import POLICIES as POLICIES
from .rules import SchedulerParams as SchedulerParams
from .rules import Weights as Weights
from .rules import default_params as default_params
from .slotted import solve as solve
from .ties import TIES as TIES

__all__ = [
    "LEVELS",
    "POLICIES",
    "TIES",
    "RequestTrace",
    "SchedulerParams",
    "Weights",
    "default_params",
    "default_trace_params",
    "make_trace",
    "metrics",
    "recorded_events",
    "replay",
    "replay_coupled",
    "run_grid",
    "solve",
    "synthetic_events",
]
