from .best import choose as choose
from .claims import Claim as Claim
from .claims import Interval as Interval
from .claims import interval as interval
from .claims import write_claims as write_claims
from .figures import band as band
from .labels import select as select
from .lines import plot as plot
from .page import write_page as write_page
from .panels import bars as bars
from .panels import sheet as sheet
from .shares import variance_shares as variance_shares
from .show import table as table
from .show import write_csv as write_csv

__all__ = [
    "Claim",
    "Interval",
    "band",
    "bars",
    "choose",
    "interval",
    "plot",
    "select",
    "sheet",
    "table",
    "variance_shares",
    "write_claims",
    "write_csv",
    "write_page",
]
