"""Claims, figures, tables and pages: general tools that know nothing of localization.

>>> from ovibjax import report
>>> report.interval([1.0, 2.0, 3.0]).text("m")
'2.00 ± 2.48 m'
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
