from .arithmetic import StreamError as StreamError
from .coder import Coder as Coder
from .rounding import Grid as Grid
from .rounding import snapped as snapped
from .tables import CODES as CODES
from .tables import CodeTable as CodeTable
from .tables import fit_table as fit_table

__all__ = ["CODES", "CodeTable", "Coder", "Grid", "StreamError", "fit_table", "snapped"]
