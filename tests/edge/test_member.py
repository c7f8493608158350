"""Member functions of encoder sweeps against the same steps done one by one."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax import sweep
from ovibjax.cards.ablation_study import GAMMA, ablate, named, table_rows
from ovibjax.edge.judging import Trained, judge_prefixes
from ovibjax.edge.member import DIMS, ORDERINGS, FuseAndLocate, JudgeOrdering, TrainAndJudge
from ovibjax.encoder.attention import AttentionConfig
from ovibjax.encoder.data_split import member_data
from ovibjax.encoder.loss import make_hypers
from ovibjax.encoder.model import Architecture, encode
from ovibjax.encoder.rate import active_dims
from ovibjax.encoder.train import TrainConfig, fit
from ovibjax.features.frames import make_feature_set
from ovibjax.views import mode_mask

ARCH = Architecture(view_dim=6, latent=8, hidden=16, last_hidden=12, head=8)
STATIC = TrainConfig(arch=ARCH, prefixes=(2, 4, 8), steps=20, batch=32)
KS = (2, 5, 8)


@pytest.fixture(scope="module")
def members():
    rng = np.random.default_rng(0)
    position = rng.uniform(-50, 50, (240, 3)).astype(np.float32)
    features = np.tanh(position @ rng.normal(size=(3, 60)) / 30).reshape(240, 5, 12)
    feature_set = make_feature_set(features, position)
    return [member_data(feature_set, seed, 6)[0] for seed in (0, 1)]


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
    judge = jax.jit(JudgeOrdering(ARCH, KS))
    trained = Trained(members[0], params)
    errors = {
        name: judge(jax.random.key(0), {"ordering": jnp.int32(i)}, trained)["test_mean_m"]
        for i, name in enumerate(ORDERINGS)
    }
    plain = jax.jit(judge_prefixes, static_argnames="arch")
    common = {"arch": ARCH, "view_mask": mode_mask("A5")}
    learned = plain(trained, **common, prefixes=jnp.array(KS)).test_error_m.mean(1)
    np.testing.assert_allclose(errors["learned"], learned, rtol=1e-4)
    # Tail first: with k = 5 of 8 the first three coordinates are dropped, i.e. multiplied by zero in the decoder.
    kernel = params["params"]["decoder_1"]["kernel"].at[:3].set(0.0)
    layer = {**params["params"]["decoder_1"], "kernel": kernel}
    without = {"params": {**params["params"], "decoder_1": layer}}
    dropped = plain(Trained(members[0], without), **common, prefixes=jnp.array([8])).test_error_m.mean(1)
    np.testing.assert_allclose(errors["tail_first"][1], dropped[0], rtol=1e-4)
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


@pytest.mark.long
def test_ablation_trains_what_it_names(members):
    def run(description, fn, axes, shared, **options):
        return sweep.run(fn, axes, shared, **options)

    found = ablate(run, STATIC, 3e-3, (GAMMA, 1.0), KS, members, [0, 1])
    trained = found.trained
    assert list(trained.variant.values) == ["no_orthogonality", "gamma_0.1", "gamma_1", "no_rate", "no_nesting"]
    assert trained.beta.sel(variant="no_rate") == 0 and trained.nesting.sel(variant="no_nesting") == 0
    # Without nesting the model is the one trained with every prefix of full length.
    static = TrainConfig(**{**STATIC.__dict__, "prefixes": (8,)})
    judge = TrainAndJudge(static, KS, ("A5",), lr=3e-3)
    alone = jax.jit(judge)(jax.random.key(0), {"beta": jnp.float32(1e-3), "gamma": jnp.float32(GAMMA)}, members[0])
    ours = trained.test_mean_m.sel(variant="no_nesting", seed=0)
    np.testing.assert_allclose(ours, alone["test_mean_m"][0], rtol=0.02)
    np.testing.assert_allclose(
        found.orders.sel(ordering="learned").values, trained.test_mean_m.sel(variant=named(GAMMA)).values, rtol=1e-3
    )
    assert found.pca.shape == (2, 3) and set(found.spectra) == {0.0, 0.1, 1.0}
    rows = table_rows(found)
    assert len(rows) == 5 * 2 * 3 + 2 * 3 * len(ORDERINGS)
    assert len({tuple(row[name] for name in ("variant", "ordering", "seed", "k")) for row in rows}) == len(rows)
    assert set(DIMS) <= set(trained.data_vars)
