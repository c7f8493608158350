"""The encoder ablation: what it trains is what it names."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax import sweep
from ovibjax.cards.ablation_study import ablate, named, table_rows
from ovibjax.cards.alpha_study import alpha_effects, metres_alpha
from ovibjax.cards.recipe_study import RECIPE_VARIANTS, changed
from ovibjax.edge.member import DIMS, ORDERINGS, TrainAndJudge
from ovibjax.encoder.loss import GAMMA
from ovibjax.encoder.train import TrainConfig
from ovibjax.sweep import program
from tests.edge.cases import KS, STATIC, two_members


@pytest.mark.long
def test_ablation_trains_what_it_names():
    members = two_members()

    def run(description, fn, axes, shared, stage="train", **options):
        return sweep.run(fn, axes, shared, **options)

    found = ablate(run, STATIC, (GAMMA, 1.0), RECIPE_VARIANTS, KS, members, [0, 1])
    trained = found.trained
    assert list(trained.variant.values) == ["no_orthogonality", "gamma_0.1", "gamma_1", "no_rate", "no_nesting"]
    assert trained.beta.sel(variant="no_rate") == 0 and trained.nesting.sel(variant="no_nesting") == 0
    # Without nesting the model is the one trained with every prefix of full length.
    static = TrainConfig(**{**STATIC.__dict__, "prefixes": (8,)})
    judge = TrainAndJudge(static, KS, ("A5",))
    alone = jax.jit(judge)(jax.random.key(0), {"beta": jnp.float32(1e-3), "gamma": jnp.float32(GAMMA)}, members[0])
    ours = trained.test_mean_m.sel(variant="no_nesting", seed=0)
    np.testing.assert_allclose(ours, alone["test_mean_m"][0], rtol=0.02)
    np.testing.assert_allclose(
        found.order_m("learned"), trained.test_mean_m.sel(variant=named(GAMMA)).values, rtol=1e-3
    )
    # What is changed in the recipe is trained as named, too.
    judge = TrainAndJudge(changed("no_completion", STATIC, len(members[1].train.x)), KS, ("A5",))
    alone = jax.jit(judge)(jax.random.key(1), {}, members[1])["test_mean_m"][0]
    np.testing.assert_allclose(found.at("no_completion", KS[-1])[1], alone[-1], rtol=0.02)
    assert len({tuple(found.recipe.test_mean_m.sel(variant=v).values.ravel()) for v in RECIPE_VARIANTS}) == 6
    assert found.pca.shape == (2, 3) and set(found.spectra) == {0.0, 0.1, 1.0}
    rows = table_rows(found)
    assert len(rows) == 11 * 2 * 3 + 2 * 3 * len(ORDERINGS)
    assert len({tuple(row[name] for name in ("variant", "ordering", "seed", "k")) for row in rows}) == len(rows)
    assert set(DIMS) <= set(trained.data_vars)
    # The panel over frames: of the learned order by hand, and random orders averaged frame by frame first.
    errors = found.orders.test_error_m.sel(ordering="learned").values
    half = 1.96 * errors.std(axis=-1, ddof=1).mean(axis=0) / np.sqrt(errors.shape[-1])
    np.testing.assert_allclose(found.half_over_frames_m("learned"), half, rtol=0.05)
    spread = found.orders.test_mean_m.values[1:-1].std(axis=0, ddof=1).mean(axis=0)
    np.testing.assert_allclose(found.deviation_of_permutations_m(), spread, rtol=1e-5)
    # Another weight of localization is a number of the same program.
    before = program.compilations
    effects = alpha_effects(run, STATIC, trained, (50.0,), members[:1], [0])
    assert program.compilations == before and list(effects.by_alpha) == [1.0, 50.0]
    point = {name: jnp.float32(value) for name, value in (("alpha", 50.0), ("beta", 0.0), ("gamma", GAMMA))}
    both = [jax.jit(TrainAndJudge(STATIC, KS, ("A5",)))(jax.random.key(0), p, members[0]) for p in (point, {})]
    without, papers = (one["test_mean_m"][0, 1] for one in both)
    with_rate = effects.by_alpha[50.0].test_mean_m.sel(variant="full", prefix=KS[1])
    np.testing.assert_allclose(effects.gain_m("no_rate", 50.0, KS[1]) + with_rate, without, rtol=0.02)
    np.testing.assert_allclose(effects.by_alpha[1.0].test_mean_m.sel(variant="full", prefix=KS[1]), papers, rtol=0.02)
    assert effects.gain_m("no_rate", 1.0, KS[1]) == found.at("no_rate", KS[1])[0] - found.at("full", KS[1])[0]
    assert effects.rate_share(50.0) < effects.rate_share(1.0)


def test_square_metres_are_the_squared_scale_of_positions():
    members = two_members()
    member, y = members[0], np.asarray(members[0].train.y)
    squared_m2 = np.sum((np.asarray(member.train_m) - np.asarray(member.standardizer.mean_m)) ** 2, axis=1)
    np.testing.assert_allclose(metres_alpha([member]) * np.sum(y**2, axis=1), squared_m2, rtol=1e-4)
    assert metres_alpha(members) == pytest.approx(np.mean([metres_alpha([one]) for one in members]))
