from .cluster_search import cluster_index as cluster_index
from .cluster_search import nearest as nearest
from .clusters import ClusterIndex as ClusterIndex
from .index import Index as Index
from .index import build_index as build_index
from .judging import Trained as Trained
from .judging import judge as judge
from .judging import judge_prefixes as judge_prefixes
from .localize import errors as errors
from .localize import mix as mix
from .localize import select_eta as select_eta
from .localize import summarize as summarize
from .member import TrainAndJudge as TrainAndJudge
from .retrieval import brute_force as brute_force
from .retrieval import coarse_to_fine as coarse_to_fine
from .retrieval import leave_one_out as leave_one_out
from .retrieval import retrieve as retrieve
from .view_fusion import calibrate as calibrate
from .view_fusion import spatial_folds as spatial_folds

__all__ = [
    "ClusterIndex",
    "Index",
    "TrainAndJudge",
    "Trained",
    "brute_force",
    "build_index",
    "calibrate",
    "cluster_index",
    "coarse_to_fine",
    "errors",
    "judge",
    "judge_prefixes",
    "leave_one_out",
    "mix",
    "nearest",
    "retrieve",
    "select_eta",
    "spatial_folds",
    "summarize",
]
