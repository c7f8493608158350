"""An edge file comes back as it went; its answers are those of the replay; a damaged one is refused in one line."""

import json

import jax
import numpy as np
import pytest

from ovibjax.control.residuals import encode_views
from ovibjax.errors import InputError
from ovibjax.features.npz import read_npz, write_npz
from ovibjax.live.edge_file import FORMAT, load_edge, save_edge
from ovibjax.live.edge_model import EdgeModel
from tests.live.cases import tiny_edge


def raw(path):
    names = set(np.load(path, allow_pickle=False).files)
    return read_npz(path, tuple(names))


def test_a_file_comes_back_as_it_went(edge_file, tmp_path):
    path = tmp_path / "again.npz"
    save_edge(path, edge_file)
    again = load_edge(path)
    for name, value in vars(edge_file).items():
        same = jax.tree.map(np.array_equal, value, getattr(again, name))
        assert jax.tree.all(same), name
    assert again.fingerprint == edge_file.fingerprint
    assert len(edge_file.fingerprint) == 16


def test_the_same_drives_give_the_same_file(edge_file):
    assert tiny_edge().fingerprint == edge_file.fingerprint


def test_nothing_in_it_is_pickled(edge_path):
    with np.load(edge_path, allow_pickle=False) as archive:
        assert {archive[name].dtype.kind for name in archive.files} <= set("iufU")


def test_robots_do_not_stand_on_references(edge_file):
    distance = np.linalg.norm(edge_file.route_m[:, None] - edge_file.reference_m[None], axis=-1)
    assert distance.min() > 0
    assert set(edge_file.route_number) == {0, 1}


def test_answers_are_those_of_the_replay(edge_file):
    """Code of a frame, decoded and retrieved one by one, against the leave-one-out residuals of all frames at once."""
    model, actions = EdgeModel(edge_file), edge_file.actions
    encode = jax.jit(encode_views, static_argnames="arch")
    for row in range(0, len(edge_file.route_m), 17):
        for a, k in enumerate(actions.prefix):
            x = edge_file.route_x[row].reshape(1, -1)
            code = np.asarray(encode(edge_file.params, x, model.masks[a], edge_file.arch))[0]
            found, distinctness = model.retrieved(a, model.decoded(a, code[:k]))
            off = np.array(model.position_m(found)) - edge_file.origin_m - edge_file.route_m[row]
            np.testing.assert_allclose(off[:2], edge_file.route_residual_m[row, a], atol=1e-4)
            assert 0 <= distinctness <= 1
            np.testing.assert_allclose(model.residual_m(a, distinctness), edge_file.route_risk_m[row, a], rtol=1e-4)


def test_what_the_edge_does_not_serve_has_no_action(edge_file):
    model = EdgeModel(edge_file)
    assert model.action_of("FS", 16) == edge_file.actions.index("FS", 16)
    assert model.action_of("FS", 17) is None


def test_every_level_of_distinctness_has_a_residual(edge_file):
    model = EdgeModel(edge_file)
    for a in range(len(edge_file.actions)):
        assert np.all(np.diff(edge_file.edges[a]) >= 0) and np.all(np.diff(edge_file.risk_m[a]) <= 0)
        assert model.residual_m(a, -2.0) == model.residual_m(a, np.nan) == edge_file.risk_m[a, 0]
        assert model.residual_m(a, 2.0) == edge_file.risk_m[a, -1]


def changed(about=None, **arrays):
    """A change of a file's arrays; None removes one."""

    def change(found):
        if about is not None:
            told = json.loads(str(found["about"]))
            found["about"] = np.array(json.dumps({**told, **about(told)}))
        return {k: v for k, v in (found | arrays).items() if v is not None}

    return change


DAMAGES = {
    "another version": (changed(format=np.array("ovibjax-edge 9")), "is not 'ovibjax-edge 2'"),
    "no format": (changed(format=None), "missing array 'format'"),
    "no text": (changed(about=None) and (lambda f: f | {"about": np.array("{")}), "'about' is damaged"),
    "not a dictionary": (lambda f: f | {"about": np.array("[]")}, "'about' is damaged"),
    "a width of text": (changed(about=lambda t: {"arch": {**t["arch"], "hidden": "64"}}), "'about' is damaged"),
    "a huge width": (changed(about=lambda t: {"arch": {**t["arch"], "hidden": 1 << 40}}), "'about' is damaged"),
    "an unknown mode": (changed(about=lambda t: {"modes": ["F", "XX"]}), "'about' is damaged"),
    "prefixes beyond the code": (changed(about=lambda t: {"prefixes": [16, 4096]}), "'about' is damaged"),
    "fewer references": (lambda f: f | {"reference_m": f["reference_m"][1:]}, "'reference_x' has shape"),
    "no reference": (
        lambda f: f | {"reference_m": f["reference_m"][:0], "reference_x": f["reference_x"][:0]},
        "no reference",
    ),
    "not finite": (lambda f: f | {"route_m": f["route_m"] * np.nan}, "'route_m' has values that are not finite"),
    "context out of range": (lambda f: f | {"route_context": f["route_context"] + 7}, "route_context"),
    "routes out of order": (lambda f: f | {"route_number": f["route_number"][::-1].copy()}, "route_number"),
    "a layer of another shape": (
        lambda f: f | {"params.decoder_1.kernel": np.zeros((3, 3), np.float32)},
        "'params.decoder_1.kernel' has shape",
    ),
    "a layer too few": (lambda f: {k: v for k, v in f.items() if k != "params.decoder_1.bias"}, "missing array"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_refused(damage, edge_path, tmp_path):
    change, message = DAMAGES[damage]
    path = tmp_path / "bad.npz"
    write_npz(path, change(raw(edge_path)))
    with pytest.raises(InputError, match=message) as told:
        load_edge(path)
    assert str(told.value).startswith(str(path))
    assert "\n" not in str(told.value)


def test_bytes_changed_anywhere_never_crash(edge_path, tmp_path):
    content = edge_path.read_bytes()
    rng = np.random.default_rng(0)
    path = tmp_path / "bad.npz"
    for _ in range(40):
        bad = bytearray(content)
        for at in rng.integers(0, len(bad), 8):
            bad[at] ^= int(rng.integers(1, 256))
        path.write_bytes(bytes(bad))
        with pytest.raises(InputError):
            load_edge(path)


def test_the_format_is_named():
    assert FORMAT == "ovibjax-edge 2"
