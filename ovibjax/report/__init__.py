"""Claims, figures, tables and pages: general tools that know nothing of localization.

>>> from ovibjax import report, sweep
>>> report.interval([1.0, 2.0, 3.0]).text("m")
'2.00 ± 2.48 m'
>>> results = sweep.run(lambda key, point, data: {"cost": (point["x"] - 2.0) ** 2}, {"x": [0.0, 1.0, 2.0, 3.0]})
>>> report.choose(results, minimise="cost").point
{'x': 2.0}
>>> report.choose(results, minimise="cost", subject_to=["cost>=0.5"]).point
{'x': 1.0}
>>> report.select(results, ["x=1,3"]).cost.values.tolist()
[1.0, 1.0]
>>> report.select(results, ["x>=1", "x!=2"]).x.values.tolist()
[1.0, 3.0]
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
