"""One small edge file for all tests, made by the first process that needs it."""

import os
import time

import pytest

from ovibjax.live.edge_file import load_edge, save_edge
from ovibjax.live.edge_model import EdgeModel
from tests.live.cases import tiny_edge


@pytest.fixture(scope="session")
def edge_path(tmp_path_factory):
    """The file of a small edge."""
    base = tmp_path_factory.getbasetemp()
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    path, mine = shared / "edge.npz", shared / "edge.being-made"
    try:
        mine.touch(exist_ok=False)
    except FileExistsError:
        for _ in range(1200):
            if path.exists():
                return path
            time.sleep(0.1)
        path = base / "edge.npz"  # whoever began it has not come to an end
    save_edge(path, tiny_edge())
    return path


@pytest.fixture(scope="session")
def edge_file(edge_path):
    """Its content."""
    return load_edge(edge_path)


@pytest.fixture(scope="session")
def edge_model(edge_file):
    """The edge's half of it, compiled."""
    model = EdgeModel(edge_file)
    model.warm_up()
    return model
