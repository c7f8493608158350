from .best import Best as Best
from .commands import check_options as check_options
from .doctor import Doctor as Doctor
from .edge_drive import EdgeDrive as EdgeDrive
from .edge_export import EdgeExport as EdgeExport
from .edge_report import EdgeReport as EdgeReport
from .edge_serve import EdgeServe as EdgeServe
from .features import Features as Features
from .replay import Replay as Replay
from .report import Report as Report
from .reproduce import Reproduce as Reproduce
from .show import Show as Show
from .sweep_merge import SweepMerge as SweepMerge
from .sweep_merge import SweepUpgrade as SweepUpgrade
from .sweep_run import SweepRun as SweepRun
from .sweep_system import SweepSystem as SweepSystem
from .sweep_train import SweepTrain as SweepTrain
from .town import Town as Town

__all__ = [
    "Best",
    "Doctor",
    "EdgeDrive",
    "EdgeExport",
    "EdgeReport",
    "EdgeServe",
    "Features",
    "Replay",
    "Report",
    "Reproduce",
    "Show",
    "SweepMerge",
    "SweepRun",
    "SweepSystem",
    "SweepTrain",
    "SweepUpgrade",
    "Town",
    "check_options",
]
