"""Functions sent whole to workers that cannot import the module they are from: cards, scripts, their helpers."""

import os
import sys
import sysconfig
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import ovibjax


@contextmanager
def by_value(cloudpickle: Any) -> Iterator[None]:
    """Pickle functions whole, not by name, if workers may not find their module: cards, scripts, their helpers."""
    roots = [sysconfig.get_path("stdlib"), str(Path(ovibjax.__file__).parent)]
    roots += [folder for folder in sys.path if folder and any(Path(folder).glob("*.dist-info"))]

    def importable(name: str, module: ModuleType) -> bool:
        file, parent = vars(module).get("__file__"), name.rpartition(".")[0]
        return not file or (
            file.startswith(tuple(f"{root}{os.sep}" for root in roots)) and parent in {"", *sys.modules}
        )

    known = cloudpickle.list_registry_pickle_by_value()
    modules = [
        module
        for name, module in list(sys.modules.items())
        if isinstance(module, ModuleType) and module.__name__ == name and name not in known
        if not importable(name, module)
    ]
    for module in modules:
        cloudpickle.register_pickle_by_value(module)
    try:
        yield
    finally:
        for module in modules:
            cloudpickle.unregister_pickle_by_value(module)
