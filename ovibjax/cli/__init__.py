"""The command line, one file per command; process-wide settings are made here alone.

A command is a dataclass whose fields are its options: `ob.cli.Show(Path("runs/mine.zarr")).run()`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
