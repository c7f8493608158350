"""One small edge file for all tests of a process."""

import pytest

from ovibjax.live.edge_file import load_edge, save_edge
from ovibjax.live.edge_model import EdgeModel
from tests.live.cases import tiny_edge


@pytest.fixture(scope="session")
def edge_path(tmp_path_factory):
    """The file of a small edge."""
    path = tmp_path_factory.mktemp("edge") / "edge.npz"
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
