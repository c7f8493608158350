"""The codec frontier: the bytes of equal error in closed form, and frames judged as the protocol says."""

import jax
import numpy as np
import pytest

from ovibjax.cards.codec_claims import codec_claims
from ovibjax.cards.codec_frontier import Frontier, fewest_bytes
from ovibjax.cards.codec_study import CodecPlan, Frozen, choose_rows, judge_codecs
from ovibjax.cards.codec_timing import encode_times_ms
from ovibjax.cards.compression_methods import LATENT
from ovibjax.edge.localize import ETAS
from ovibjax.encoder.model import Architecture, init, locate
from ovibjax.encoder.training_data import member_data
from ovibjax.features.frames import make_feature_set
from ovibjax.features.splits import split_indices
from ovibjax.report.claims import HELD, NOT_HELD
from ovibjax.world.town.coded import CodedViews

RUNGS = (("jpeg", 1), ("jpeg", 8), ("h265", 51))
RAW_M = np.random.default_rng(1).uniform(0, 9, (1, 39)).astype(np.float32)
ENCODE_MS = np.array([5.0, 8.0, 90.0])
SIZES = np.array([1000.0, 4000.0, 16000.0])


def test_fewest_bytes_interpolates_in_the_logarithm():
    errors = np.array([9.0, 5.0, 3.0])
    assert fewest_bytes(SIZES, errors, 9.0) == 1000.0
    assert fewest_bytes(SIZES, errors, 20.0) == 1000.0
    assert fewest_bytes(SIZES, errors, 5.0) == pytest.approx(4000.0)
    assert fewest_bytes(SIZES, errors, 7.0) == pytest.approx(2000.0)
    assert fewest_bytes(SIZES, errors, 4.0) == pytest.approx(8000.0)
    assert fewest_bytes(SIZES, errors, 2.9) == float("inf")
    # The first rung that reaches it counts, even if a later one is worse again.
    assert fewest_bytes(SIZES, np.array([9.0, 4.0, 6.0]), 4.0) == pytest.approx(4000.0)


def test_frames_are_chosen_by_seed_and_no_more_than_there_are():
    mine = choose_rows(39, 3, 7)
    assert len(np.unique(mine)) == 7 and mine.min() >= 0 and mine.max() < 39
    assert (choose_rows(39, 4, 7) != mine).any()
    np.testing.assert_array_equal(choose_rows(39, 3, 10**6), np.arange(39))


@pytest.fixture(scope="module")
def frontier():
    """Two seeds; the first JPEG rung shows every frame as frame 0, the others change nothing."""
    rng = np.random.default_rng(0)
    position = rng.uniform(-40, 40, (260, 3)).astype(np.float32)
    features = np.tanh(position @ rng.normal(size=(3, 4 * 9)) / 30).reshape(260, 4, 9) + 0.02
    feature_set = make_feature_set(features, position)
    prepared = {seed: member_data(feature_set, seed, rank=6) for seed in (1, 2)}
    params = init(jax.random.key(0), Architecture(n_views=4, view_dim=6, latent=LATENT))
    n_test = len(split_indices(260, 1).test)
    error = np.arange(LATENT * n_test, dtype=np.float32).reshape(LATENT, n_test)
    frozen = {seed: Frozen(params, RAW_M[0], float(error[31].mean())) for seed in prepared}
    asked = []

    def code(frames):
        asked.append(frames)
        plain = feature_set.features[frames]
        coded = np.stack([np.broadcast_to(feature_set.features[:1], plain.shape), plain, plain], axis=1)
        sizes = frames[:, None] * np.array([1, 10, 100]) + np.array([1, 2, 3])
        return CodedViews(plain, coded, sizes)

    found = judge_codecs(feature_set, prepared, frozen, CodecPlan(12, RUNGS), code, ENCODE_MS)
    return found, asked, feature_set, error


def test_codecs_are_judged_like_uncompressed_frames(frontier):
    found, asked, _, error = frontier
    assert len(asked) == 1 and len(np.unique(asked[0])) == len(asked[0])
    assert found.error_m.shape == (2, 3, 12) and found.seeds == (1, 2) and found.codecs == ("jpeg", "h265")
    np.testing.assert_allclose(found.error_m[:, 1:].mean(axis=2), np.stack([found.plain_m] * 2, axis=1), rtol=1e-6)
    assert (found.error_m[:, 0].mean(axis=1) > 2 * found.plain_m).all()
    for row, seed in enumerate(found.seeds):
        mine = choose_rows(39, seed, 12)
        expected = split_indices(260, seed).test[mine].mean() * np.array([1, 10, 100]) + [1, 2, 3]
        np.testing.assert_allclose(found.payload_bytes[row], expected)
        assert found.ovib_m[row] == pytest.approx(error[31].mean())
        # What coding adds on the coded frames comes on top of all test frames.
        added_m = found.error_m[row].mean(axis=1) - RAW_M[0, mine].mean()
        np.testing.assert_allclose(found.mean_m[row], RAW_M.mean() + added_m, rtol=1e-5)
        np.testing.assert_allclose(found.of("h265")[1][row], found.mean_m[row, 2:])


def test_uncompressed_frames_against_plain_numpy(frontier):
    """Regress, retrieve, choose the mixing weight on all validation frames, measure."""
    found, _, feature_set, _ = frontier
    split = split_indices(260, 1)
    member, basis = member_data(feature_set, 1, rank=6)
    arch = Architecture(n_views=4, view_dim=6, latent=LATENT)
    database = np.asarray(member.train.x).reshape(len(split.train), -1)
    database = database / np.linalg.norm(database, axis=1, keepdims=True)

    def miss_m(frames, eta):
        centred = feature_set.features[frames] - basis.mean
        x = np.concatenate([centred[:, v] @ basis.axes[v] for v in range(4)], axis=1) / basis.scale
        retrieved = feature_set.positions_m[split.train][(x @ database.T).argmax(axis=1)]
        head = np.asarray(locate(init(jax.random.key(0), arch), x, arch)) * float(member.standardizer.scale_m)
        regressed = head + np.asarray(member.standardizer.mean_m)
        return np.linalg.norm(eta * regressed + (1 - eta) * retrieved - feature_set.positions_m[frames], axis=1)

    eta = min(ETAS, key=lambda eta: miss_m(split.val, eta).mean())
    np.testing.assert_allclose(found.error_m[0, 1], miss_m(split.test[choose_rows(39, 1, 12)], eta), rtol=1e-3)


def test_table_has_a_row_per_rung_and_seed(frontier):
    rows = frontier[0].table_rows()
    assert len(rows) == 6 and list(rows[0]) == [
        "codec",
        "quality",
        "seed",
        "payload_bytes",
        "mean_m",
        "p90_m",
        "encode_ms",
    ]


def made(factor, errors=(4.0, 3.0, 3.0), ovib=4.0, encode_ms=(0.0, 0.0, 0.0)):
    """Three seeds on which every rung costs `factor` times O-VIB-32's 148 bytes, doubling per rung."""
    sizes = np.tile(148.0 * factor * np.array([1.0, 2.0, 1.0]), (3, 1)) * np.array([[0.99], [1.0], [1.01]])
    error = np.tile(np.array(errors, np.float32)[None, :, None], (3, 1, 4))
    level = np.full(3, 2.0)
    return Frontier(RUNGS, (1, 2, 3), sizes, error, level, level, level, np.full(3, ovib), np.array(encode_ms))


@pytest.mark.parametrize(
    ("frontier_", "size", "speed", "word"),
    [
        (made(100), HELD, NOT_HELD, "H.265 at most 100.0"),
        (made(300), HELD, HELD, "300.0"),
        (made(10), NOT_HELD, NOT_HELD, "10.0"),
        # JPEG reaches the error at its second rung only.
        (made(30, errors=(5.0, 4.0, 5.0)), HELD, NOT_HELD, "JPEG 60.0"),
        (made(10, errors=(9.0, 9.0, 9.0)), HELD, HELD, "JPEG never on 3 of 3"),
        # Encoding counts: 50 times O-VIB's 50.4 ms, and the first rung of JPEG that reaches the error is the second.
        (made(10, errors=(5.0, 4.0, 5.0), encode_ms=(0.0, 2600.0, 0.0)), NOT_HELD, HELD, "JPEG 20.0"),
    ],
)
def test_claims(frontier_, size, speed, word):
    by_size, by_speed = codec_claims(frontier_, link_kb_per_s=8)
    assert (by_size.verdict, by_speed.verdict) == (size, speed)
    assert word in by_size.ours and "12 frames were coded, and failures on fewer than one in 4" in by_size.ours


def test_latency_is_encoding_at_the_rung_of_equal_error_plus_transmission():
    frontier = made(10, errors=(5.0, 4.0, 5.0), encode_ms=(7.0, 30.0, 11.0))
    np.testing.assert_array_equal(frontier.equal_error_encode_ms("jpeg"), [30.0, 30.0, 30.0])
    sent_ms = 1e3 * 8 * 148 * 20 * np.array([0.99, 1.0, 1.01]) / 65536
    np.testing.assert_allclose(frontier.latency_ms("jpeg", 65536.0), 30.0 + sent_ms, rtol=1e-6)
    assert np.isinf(frontier.latency_ms("h265", 65536.0)).all()


def test_encoding_is_timed_by_rung():
    pictures = [np.random.default_rng(i).integers(0, 256, (5, 60, 80, 3), np.uint8) for i in range(2)]
    times_ms = encode_times_ms(pictures, (("jpeg", 40), ("webp", 70)))
    assert times_ms.shape == (2,) and 0 < times_ms[0] < times_ms[1] < 1e4
