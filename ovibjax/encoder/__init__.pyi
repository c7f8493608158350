from .loss import Hypers as Hypers
from .loss import make_hypers as make_hypers
from .loss import prefix_mask as prefix_mask
from .model import Architecture as Architecture
from .model import decode as decode
from .model import encode as encode
from .model import init as init
from .model import locate as locate
from .orthogonality import orthogonality_penalty as orthogonality_penalty
from .rate import active_dims as active_dims
from .rate import ard_kl as ard_kl
from .rate import gaussian_kl as gaussian_kl
from .train import TrainConfig as TrainConfig
from .train import TrainData as TrainData
from .train import fit as fit
from .train import fixed_rate as fixed_rate
from .train import for_bits as for_bits
from .train import paper_recipe as paper_recipe
from .training_data import MemberData as MemberData
from .training_data import member_data as member_data

__all__ = [
    "Architecture",
    "Hypers",
    "MemberData",
    "TrainConfig",
    "TrainData",
    "active_dims",
    "ard_kl",
    "decode",
    "encode",
    "fit",
    "fixed_rate",
    "for_bits",
    "gaussian_kl",
    "init",
    "locate",
    "make_hypers",
    "member_data",
    "orthogonality_penalty",
    "paper_recipe",
    "prefix_mask",
]
