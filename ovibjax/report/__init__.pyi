from .best import choose as choose
from .claims import Claim as Claim
from .claims import Interval as Interval
from .claims import interval as interval
from .claims import write_claims as write_claims
from .export import write_csv as write_csv
from .export import write_parquet as write_parquet
from .figures import band as band
from .live import watch as watch
from .main_effects import Effects as Effects
from .main_effects import effects as effects
from .page import write_page as write_page
from .panels import bars as bars
from .panels import sheet as sheet
from .plotting import plot as plot
from .ranking import Ranking as Ranking
from .selection import select as select
from .shares import variance_shares as variance_shares
from .show import table as table
from .web.results_html import write_results_page as write_results_page
from .web.sweep_html import write_sweep_page as write_sweep_page

__all__ = [
    "Claim",
    "Effects",
    "Interval",
    "Ranking",
    "band",
    "bars",
    "choose",
    "effects",
    "interval",
    "plot",
    "select",
    "sheet",
    "table",
    "variance_shares",
    "watch",
    "write_claims",
    "write_csv",
    "write_page",
    "write_parquet",
    "write_results_page",
    "write_sweep_page",
]
