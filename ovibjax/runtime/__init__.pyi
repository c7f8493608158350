from .cache import cache_folder as cache_folder
from .cache import keep_compiled_programs as keep_compiled_programs
from .precision import PRECISIONS as PRECISIONS
from .precision_choice import faster_precision as faster_precision
from .progress import progress_bar as progress_bar
from .threads import in_order as in_order
from .threads import in_threads as in_threads
from .threads import one_blas_thread as one_blas_thread
from .threads import pool_threads as pool_threads
from .threads import workers as workers

__all__ = [
    "PRECISIONS",
    "cache_folder",
    "faster_precision",
    "in_order",
    "in_threads",
    "keep_compiled_programs",
    "one_blas_thread",
    "pool_threads",
    "progress_bar",
    "workers",
]
