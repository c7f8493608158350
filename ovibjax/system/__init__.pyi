from .chain import DIMS as DIMS
from .chain import along as along
from .chain import run as run
from .data import SystemConfig as SystemConfig
from .data import SystemData as SystemData
from .data import SystemSize as SystemSize
from .data import make_system as make_system
from .grids import sweep_system as sweep_system
from .stages import HYPERS as HYPERS

__all__ = [
    "DIMS",
    "HYPERS",
    "SystemConfig",
    "SystemData",
    "SystemSize",
    "along",
    "make_system",
    "run",
    "sweep_system",
]
