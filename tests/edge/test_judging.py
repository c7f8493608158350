"""The frozen-localizer protocol against a plain NumPy reading of it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.edge import judging
from ovibjax.edge.judging import Trained, one_standard_error_choice
from ovibjax.edge.localize import ETAS
from ovibjax.encoder import model, pca
from ovibjax.encoder.model import Architecture, init
from ovibjax.encoder.training_data import member_data
from ovibjax.views import mode_mask
from tests.encoder.cases import smooth_frames

ARCH = Architecture(n_views=4, view_dim=6, latent=8, hidden=16, last_hidden=12, head=8)

# One program each, not one for every operation in them.
judge_prefixes = jax.jit(judging.judge_prefixes, static_argnames=("arch", "recode"))
judge_raw = jax.jit(judging.judge_raw, static_argnames="arch")
encode, decode, locate = (jax.jit(f, static_argnames="arch") for f in (model.encode, model.decode, model.locate))
fit_pca, pca_decode = jax.jit(pca.fit_pca, static_argnums=1), jax.jit(pca.pca_decode)


@pytest.fixture(scope="module")
def feature_set():
    return smooth_frames()


@pytest.fixture(scope="module")
def member(feature_set):
    return member_data(feature_set, seed=1, rank=6)[0]


@pytest.fixture(scope="module")
def params():
    return jax.jit(init, static_argnums=1)(jax.random.key(3), ARCH)


def oracle(params, member, mask, codec, recode):
    """Encode, mask, regress, retrieve, mix on validation, measure: one frame at a time."""
    wide = np.repeat(np.asarray(mask), ARCH.view_dim)
    database = np.asarray(member.train.x).reshape(len(member.train.x), -1) * wide
    if recode:
        database = np.asarray(codec(jnp.asarray(database))) * wide
    database = database / np.linalg.norm(database, axis=1, keepdims=True)
    out = {}
    for name, x, truth in (("val", member.val_x, member.val_m), ("test", member.test_x, member.test_m)):
        descriptor = np.asarray(codec(jnp.asarray(np.asarray(x).reshape(len(x), -1) * wide))) * wide
        reg = np.asarray(locate(params, jnp.asarray(descriptor), ARCH)) * float(member.standardizer.scale_m)
        reg = reg + np.asarray(member.standardizer.mean_m)
        ret = np.asarray(member.train_m)[[int(np.argmax(database @ row)) for row in descriptor]]
        out[name] = reg, ret, np.asarray(truth)

    def error(eta, name):
        reg, ret, truth = out[name]
        return np.linalg.norm(eta * reg + (1 - eta) * ret - truth, axis=1)

    return error


@pytest.mark.parametrize("mode", ["F", "FS", "H4"])
@pytest.mark.parametrize("linear", [False, True])
def test_prefixes_match_the_protocol(params, member, mode, linear) -> None:
    mask = mode_mask(mode, 4)
    ks = [2, 5, 8]
    # A re-coded database is tried with the linear code: an untrained network maps all references to one direction,
    # where rounding decides which of them is nearest.
    linear_code = fit_pca(member.train.x, 8) if linear else None
    judged = judge_prefixes(Trained(member, params), ARCH, mask, jnp.array(ks), pca=linear_code, recode=linear)
    for i, k in enumerate(ks):
        keep = jnp.asarray((np.arange(8) < k).astype(np.float32))

        def codec(x, keep=keep):
            if linear_code is not None:
                return pca_decode(linear_code, pca.pca_coordinates(linear_code, x), keep)
            return decode(params, encode(params, x, ARCH)[0], keep, ARCH)

        error = oracle(params, member, mask, codec, recode=linear)
        eta = float(judged.eta[i])
        # Near a flat minimum rounding may pick a neighbour; what counts is that none is better on validation.
        assert error(eta, "val").mean() <= min(error(other, "val").mean() for other in ETAS) + 1e-2
        for name, ours in (("val", judged.val_error_m[i]), ("test", judged.test_error_m[i])):
            same = np.isclose(ours, error(eta, name), rtol=2e-3, atol=1e-2)
            assert same.mean() > 0.97, (name, k, same.mean())


def test_raw_retrieval_of_a_reference_is_exact(params, member) -> None:
    known = member._replace(val_x=member.train.x[:20], val_m=member.train_m[:20])
    judged = judge_raw(Trained(known, params), ARCH, mode_mask("H4", 4))
    assert float(judged.eta) == 0.0
    np.testing.assert_allclose(judged.val_error_m, 0.0, atol=1e-5)


def test_test_frames_do_not_choose_the_mixing_weight(params, member) -> None:
    shuffled = member._replace(test_m=member.test_m[::-1] + 50.0)
    mask = mode_mask("H4", 4)
    one, other = (judge_raw(Trained(m, params), ARCH, mask) for m in (member, shuffled))
    assert float(one.eta) == float(other.eta)
    np.testing.assert_array_equal(one.val_error_m, other.val_error_m)


def test_one_standard_error_rule() -> None:
    rng = np.random.default_rng(0)
    noise = rng.normal(0, 1, 400)
    noise = (noise - noise.mean()) / noise.std(ddof=1)  # standard error 0.05
    means = np.array([9.0, 5.06, 5.04, 5.0, 5.01])
    errors = jnp.asarray(means[:, None] + noise[None], jnp.float32)
    assert int(one_standard_error_choice(errors, jnp.array([2, 4, 8, 16, 32]))) == 8
