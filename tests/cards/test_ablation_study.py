"""The encoder ablation: what it trains is what it names."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax import sweep
from ovibjax.cards.ablation_study import ablate, named, table_rows
from ovibjax.cards.recipe_study import RECIPE_VARIANTS, changed
from ovibjax.edge.member import DIMS, ORDERINGS, TrainAndJudge
from ovibjax.encoder.loss import GAMMA
from ovibjax.encoder.train import TrainConfig
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
        found.orders.sel(ordering="learned").values, trained.test_mean_m.sel(variant=named(GAMMA)).values, rtol=1e-3
    )
    # What is changed in the recipe is trained as named, too.
    judge = TrainAndJudge(changed("no_completion", STATIC), KS, ("A5",))
    alone = jax.jit(judge)(jax.random.key(1), {}, members[1])["test_mean_m"][0]
    np.testing.assert_allclose(found.at("no_completion", KS[-1])[1], alone[-1], rtol=0.02)
    assert len({tuple(found.recipe.test_mean_m.sel(variant=v).values.ravel()) for v in RECIPE_VARIANTS}) == 5
    assert found.pca.shape == (2, 3) and set(found.spectra) == {0.0, 0.1, 1.0}
    rows = table_rows(found)
    assert len(rows) == 10 * 2 * 3 + 2 * 3 * len(ORDERINGS)
    assert len({tuple(row[name] for name in ("variant", "ordering", "seed", "k")) for row in rows}) == len(rows)
    assert set(DIMS) <= set(trained.data_vars)
