"""What the cards (one file per figure or table) share: the job, studies, claims and drawing by topic.

A card is a Python file with `TITLE` and `run(job)`; `ob.reproduce` runs cards.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
