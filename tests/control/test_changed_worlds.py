"""Worlds that change: what is replaced, from when on, by which real answers."""

import jax
import numpy as np

from ovibjax.control.actions import ACTIONS, actions_for
from ovibjax.control.changed_worlds import (
    from_slot,
    front_as_good_as_all,
    no_longer_repetitive,
    noisy,
    one_after_another,
    true_prior_m,
)
from ovibjax.control.drives import join_drives
from ovibjax.control.residuals import answers
from ovibjax.control.scene import Reading, cut_scene
from ovibjax.encoder.checkpoint import train_checkpoint
from ovibjax.features.frames import CONTEXTS
from tests.control.cases import SLOTS, TINY, drive, make_route


def on_host(route):
    return jax.tree.map(np.asarray, route)


def test_the_front_view_brings_what_all_views_bring():
    for actions in (ACTIONS, actions_for(4, ACTIONS)):
        route = on_host(make_route(0, actions=len(actions)))
        found = front_as_good_as_all(route, actions)
        for a in (0, 1):
            np.testing.assert_array_equal(found.residual_m[:, a], route.residual_m[:, -1])
            np.testing.assert_array_equal(found.risk_m[:, a], route.risk_m[:, -1])
        np.testing.assert_array_equal(found.residual_m[:, 2:], route.residual_m[:, 2:])


def test_repetitive_blocks_are_answered_as_corridors():
    route = on_host(make_route(1))
    found = no_longer_repetitive(route, CONTEXTS)
    blocks = route.context == CONTEXTS.index("repetitive")
    assert blocks.any()
    np.testing.assert_array_equal(found.risk_m[~blocks], route.risk_m[~blocks])
    corridor = {tuple(row) for row in route.residual_m[route.context == CONTEXTS.index("corridor"), :, 0].tolist()}
    assert {tuple(row) for row in found.residual_m[blocks, :, 0].tolist()} <= corridor
    alone = route._replace(context=np.full(SLOTS, 2, np.int32))
    np.testing.assert_array_equal(no_longer_repetitive(alone, CONTEXTS).risk_m, route.risk_m)


def test_nothing_changes_before_the_slot():
    route, other = on_host(make_route(2)), on_host(make_route(3))
    found = from_slot(route, other, 20)
    for name in ("residual_m", "risk_m"):
        before, after = getattr(found, name)[:20], getattr(found, name)[20:]
        np.testing.assert_array_equal(before, getattr(route, name)[:20])
        np.testing.assert_array_equal(after, getattr(other, name)[20:])
    np.testing.assert_array_equal(found.context, route.context)


def test_routes_one_after_another_twice():
    routes = [on_host(make_route(seed)) for seed in (4, 5)]
    found = one_after_another(routes, 2)
    for name in found._fields:
        once = np.concatenate([getattr(route, name) for route in routes])
        np.testing.assert_array_equal(getattr(found, name), np.concatenate([once, once]))


def test_an_oracle_knows_both_worlds():
    prior = np.arange(12.0).reshape(2, 3, 2)
    np.testing.assert_array_equal(
        true_prior_m(prior, np.array([0, 2, 2, 1]), 2), [prior[0, 0], prior[0, 2], prior[1, 2], prior[1, 1]]
    )


def test_noise_keeps_unit_norm_and_has_the_length_that_it_says():
    features = drive(0).features
    found = noisy(features, 0.5)
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1.0, rtol=1e-5)
    np.testing.assert_allclose(np.sum(found * features, axis=-1).mean(), 1 / np.sqrt(1.25), atol=0.02)


def test_what_robots_send_may_differ_from_what_the_edge_keeps():
    frames = join_drives([drive(1), drive(2)], 1)
    trained = train_checkpoint(jax.random.key(0), frames.first_frames, TINY)
    edge = trained, frames.features, frames.positions_m, frames.references, ACTIONS
    usual, same = answers(*edge), answers(*edge, sent=frames.features)
    np.testing.assert_array_equal(same.residual_m, usual.residual_m)
    np.testing.assert_allclose(same.distinctness, usual.distinctness, atol=1e-5)
    bad = cut_scene(frames, trained, Reading(prior="calibrated"), noisy(frames.features, 2.0))
    good = cut_scene(frames, trained, Reading(prior="calibrated"))
    np.testing.assert_array_equal(bad.predictor_m, good.predictor_m)  # priors are of what training knew
    assert bad.held_out[0].risk_m.mean() > good.held_out[0].risk_m.mean()
    lengths = [np.linalg.norm(scene.held_out[0].residual_m, axis=-1).mean() for scene in (bad, good)]
    assert lengths[0] > 1.2 * lengths[1]
