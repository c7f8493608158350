"""Member functions of encoder sweeps against the same steps done one by one."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.edge.judging import Trained, judge, judge_prefixes
from ovibjax.edge.member import ORDERINGS, FuseAndLocate, JudgeOrdering, TrainAndJudge, labels_of
from ovibjax.encoder.attention import AttentionConfig
from ovibjax.encoder.bits import code_bits
from ovibjax.encoder.loss import make_hypers
from ovibjax.encoder.model import decode, encode
from ovibjax.encoder.rate import active_dims
from ovibjax.encoder.train import fit
from ovibjax.link.codes.rounding import Grid
from ovibjax.views import mode_mask
from tests.edge.cases import ARCH, KS, STATIC, two_members


@pytest.fixture(scope="module")
def members():
    return two_members()


def test_train_and_judge_is_fit_then_judge(members):
    fn = TrainAndJudge(STATIC, KS, ("F",), lr=3e-3, keep_params=True)
    found = jax.jit(fn)(jax.random.key(4), {"gamma": jnp.float32(0.3), "seed": jnp.int32(4)}, members[0])
    train = jax.jit(fit, static_argnames="static")
    params, metrics = train(jax.random.key(4), make_hypers(gamma=0.3, lr=3e-3), members[0].train, STATIC)
    for name, values in metrics.items():
        np.testing.assert_allclose(found[name], values[-1], rtol=1e-4)
    judge = jax.jit(judge_prefixes, static_argnames="arch")
    for i, mode in enumerate(("F",)):
        judged = judge(Trained(members[0], params), arch=ARCH, view_mask=mode_mask(mode), prefixes=jnp.array(KS))
        np.testing.assert_allclose(found["test_mean_m"][i], judged.test_error_m.mean(1), rtol=1e-3)
        np.testing.assert_allclose(found["val_mean_m"][i], judged.val_error_m.mean(1), rtol=1e-3)
        p90 = np.percentile(judged.test_error_m, 90, axis=1)
        np.testing.assert_allclose(found["test_p90_m"][i], p90, rtol=1e-3)
    x = members[0].val_x.reshape(len(members[0].val_x), -1)
    assert found["active_dims"] == active_dims(*encode(params, x, ARCH))
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-5), found["params"], params["params"])


def test_orderings_keep_the_coordinates_they_say(members):
    params, _ = jax.jit(fit, static_argnames="static")(jax.random.key(0), make_hypers(), members[0].train, STATIC)
    by_order = jax.jit(JudgeOrdering(ARCH, KS))
    trained = Trained(members[0], params)
    errors = {
        name: by_order(jax.random.key(0), {"ordering": jnp.int32(i)}, trained)["test_mean_m"]
        for i, name in enumerate(ORDERINGS)
    }
    plain = jax.jit(judge_prefixes, static_argnames="arch")
    common = {"arch": ARCH, "view_mask": mode_mask("A5")}
    learned = plain(trained, **common, prefixes=jnp.array(KS)).test_error_m.mean(1)
    np.testing.assert_allclose(errors["learned"], learned, rtol=1e-4)
    # Tail first: with k = 5 of 8 the first three coordinates are not sent.
    last = jnp.float32([0, 0, 0, 1, 1, 1, 1, 1])

    def tail(x):
        return decode(params, encode(params, x, ARCH)[0], last, ARCH)

    sent = jax.jit(judge, static_argnames=("arch", "codec"))(trained, ARCH, mode_mask("A5"), tail).test_error_m.mean()
    np.testing.assert_allclose(errors["tail_first"][1], sent, rtol=1e-4)
    # All coordinates are the same in any order; the permutations differ from each other before.
    for name in ORDERINGS:
        np.testing.assert_allclose(errors[name][-1], learned[-1], rtol=1e-4)
    assert len({float(errors[name][0]) for name in ORDERINGS}) > 4


def test_fusion_baseline_is_judged_in_metres(members):
    static = AttentionConfig(view_dim=6, width=16, heads=2, blocks=1, mlp=16, steps=60, batch=32, warmup=5)
    found = jax.jit(FuseAndLocate(static))(jax.random.key(0), {"seed": jnp.int32(0)}, members[0])
    truth, train = np.asarray(members[0].test_m), np.asarray(members[0].train_m)
    guess = np.linalg.norm(truth - train.mean(0), axis=1).mean()
    assert 0.5 < float(found["test_mean_m"]) < guess


def test_trained_for_bits_codes_are_rounded_before_they_are_judged(members):
    static = dataclasses.replace(STATIC, prior="bits")
    fn = TrainAndJudge(static, KS, ("F", "A5"), keep_params=True)
    found = jax.jit(fn)(jax.random.key(4), {"beta": jnp.float32(0.01)}, members[0])
    params, data = {"params": found["params"]}, members[0]
    x = data.test_x.reshape(len(data.test_x), -1)
    step = np.exp(found["params"]["bits"]["log_step"])
    received = np.rint(np.asarray(encode(params, x, ARCH)[0]) / step) * step
    cost = np.cumsum(np.asarray(code_bits(params, jnp.asarray(received))).mean(axis=0))
    np.testing.assert_allclose(found["code_bits"][1], cost[np.array(KS) - 1], rtol=1e-3)
    assert labels_of("bits")["units"]["rate"] == "bits" and set(labels_of("bits")["dims"]) <= set(found)
    plain = {"params": {name: layer for name, layer in found["params"].items() if name != "bits"}}
    # The same network whose coordinates are rounded from outside, and not at all.
    grid = Grid(jnp.float32(step), jnp.full(8, -(2**20)), jnp.full(8, 2**20))
    run = jax.jit(judge_prefixes, static_argnames="arch")
    by_grid, exact = (
        run(Trained(data, plain, rounded), arch=ARCH, view_mask=mode_mask("A5"), prefixes=jnp.array(KS))
        for rounded in (grid, None)
    )
    np.testing.assert_allclose(found["test_mean_m"][1], by_grid.test_error_m.mean(1), rtol=1e-3)
    assert not np.allclose(found["test_mean_m"][1], exact.test_error_m.mean(1), rtol=1e-3)
