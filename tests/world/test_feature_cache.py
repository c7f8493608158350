"""Cached features: their key covers every module they depend on, and what is damaged is made again."""

import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.features.frames import make_feature_set
from ovibjax.world.feature_cache import content_key, keep, kept
from ovibjax.world.rooms import feature_set as rooms
from ovibjax.world.town import coded
from ovibjax.world.town import feature_set as town
from tests.test_imports import ALL, imports

PATHS = {name: path for path, name in ALL.items()}
# Files, folders, checks and progress: they change no value of a rendered feature. So does the choice of a backbone by
# name; the backbone's own fingerprint is part of the key.
NO_MATTER = ("errors", "views", "runtime", "features.frames", "features.feature_files", "features.npz")
NO_MATTER += ("features.backbones.by_name", "features.backbones.onnx", "features.backbones.clip", "world.feature_cache")


def depends_on(name, found):
    """Names of all modules that one depends on, itself included, less those that do not matter."""
    if name in found or name.startswith(NO_MATTER):
        return found
    found.add(name)
    for target in imports(PATHS[name], name):
        if target in PATHS:
            depends_on(target, found)
    return found


@pytest.mark.parametrize(
    ("module", "sources", "also"),
    [
        ("world.town.feature_set", town.SOURCES, set()),
        ("world.rooms.feature_set", rooms.SOURCES, set()),
        ("world.town.coded", coded._SOURCES, {"features.backbones.embedded"}),
    ],
)
def test_the_key_covers_every_module_that_features_depend_on(module, sources, also):
    needed = depends_on(module, set())
    for name in also:
        depends_on(name, needed)
    assert sorted(sources) == sorted(needed)


def test_keys_depend_on_facts_and_code():
    keys = {content_key(facts, modules) for facts in (1, 2) for modules in (("world.rays",), ("world.patterns",))}
    assert len(keys) == 4 and all(len(key) == 20 for key in keys)
    assert content_key(1, ("world.rays",)) in keys


def test_sets_that_belong_together_are_kept_and_lost_together(tmp_path):
    paths = tmp_path / "cache" / "a.npz", tmp_path / "cache" / "b.npz"
    sets = [make_feature_set(np.ones((n, 4, 3)), np.zeros((n, 3))) for n in (2, 3)]
    assert kept(*paths) is None
    keep(dict(zip(paths, sets, strict=True)))
    assert [len(found.features) for found in kept(*paths)] == [2, 3]
    paths[1].write_bytes(b"damaged")
    assert kept(*paths) is None and not any(path.exists() for path in paths)


def test_a_cache_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="OVIBJAX_CACHE"):
        keep({tmp_path / "file" / "a.npz": make_feature_set(np.ones((2, 4, 3)), np.zeros((2, 3)))})
    with pytest.raises(InputError, match="OVIBJAX_CACHE"):
        kept(tmp_path / "file" / "a.npz")  # before anything is made to be kept


def test_a_cache_that_cannot_be_written_is_named_before_a_town_is_rendered(tmp_path, monkeypatch):
    from ovibjax.world.town import feature_set as town

    monkeypatch.setenv("OVIBJAX_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(town, "render_features", lambda *_: pytest.fail("the town was rendered"))
    monkeypatch.setattr("os.access", lambda *_: False)
    with pytest.raises(
        InputError, match=r"cache: the cache folder cannot be made \(Permission denied\); set OVIBJAX_CACHE"
    ):
        town.town_features(n_frames=4)
