"""What is chosen within a budget of bytes, and what coordinates and packets cost, on rows made up by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from ovibjax.cards import bytes_coding
from ovibjax.cards.bytes_choice import COMPACT, PACKET, at_prefix, best_within, chosen, one_price
from ovibjax.cards.bytes_claims import BUDGETS, GOALS_M, bytes_claims, surrogate
from ovibjax.cards.bytes_coding import KS, Coding, Network, bits_of, overheads_bytes
from ovibjax.cards.bytes_study import BytesRuns
from ovibjax.edge.judging import Trained
from ovibjax.encoder.loss import BETA
from ovibjax.encoder.model import Architecture
from ovibjax.link.coded_packets import CodedRequest, pack_coded, pack_compact
from ovibjax.link.codes.coder import Coder
from ovibjax.link.codes.tables import fit_table


def row(method, k, size, error, seed=0, **other):
    given = {"code": "entropy", "setting": BETA if method != "pca" else 0.0, "step": 0.5} | other
    sizes = {"code_bytes": size, "ideal_bytes": size, "packet_bytes": size + 40, "compact_bytes": size + 13}
    return {"method": method, "k": k, "seed": seed, "val_mean_m": error, "mean_m": error + 1} | given | sizes


def runs():
    """Two seeds: training for bits at two prices, of which the dear one is shorter; others are worse by metres."""
    rows = []
    for seed in (0, 1):
        for i, k in enumerate(KS):
            rows += [row("bits", k, 3 + 4 * i, 8 / (i + 1) + seed, seed, setting=1e-3)]
            rows += [row("bits", k, 2 + 4 * i, 7 / (i + 1) + 2.5 * (i > 0) + seed, seed, setting=4e-3)]
            rows += [row("pca", k, 2 + 4 * i, 9 / (i + 1) + 3 + seed, seed)]
            rows += [row("pca_completed", k, 4 + 4 * i, 9 / (i + 1) + 2 + seed, seed)]
            if k in (8, 16):
                rows += [row("ard", k, 4 * k, 20.0 + seed, seed, code="float32", step=0.0)]
                rows += [row("pq", k, k, 30.0 + seed, seed, code="bytes", step=0.0)]
            for code, step in (("float32", 0.0), ("int8", 0.0), ("entropy", 0.5), ("entropy", 1.0)):
                size = {"float32": 4 * k, "int8": k}.get(code, 4 + 4 * i)
                rows += [row("ovib", k, size, 8 / (i + 1) + seed + 0.1 * (code == "int8"), seed, code=code, step=step)]
    coordinates = {("ovib", BETA): np.full(128, 2.0)}
    rate = {("ovib", BETA): np.array([100.0, 120.0]), ("bits", 1e-3): np.array([50.0, 52.0])}
    return BytesRuns(rows, 0.5, coordinates | {("bits", 1e-3): np.full(128, 0.5)}, rate, {})


def test_the_lowest_validation_error_within_the_budget_is_chosen():
    found = runs()
    every = best_within(found.rows, 7.0, lambda row: row["method"] == "bits")
    assert every.error_m.tolist() == [5.0, 6.0] and every.name == f"k = {KS[1]}, entropy, step 0.5, λ 0.001"
    assert chosen(found.rows, "bits", 6.0, 4e-3).name.startswith(f"k = {KS[1]}")
    assert chosen(found.rows, "bits", 1.0) is None
    assert chosen(found.rows, "floats", 4 * KS[0]).name == f"k = {KS[0]}, float32"
    assert chosen(found.rows, "floats", 4 * KS[0] - 1) is None
    assert chosen(found.rows, "ard", 39.0).name == "k = 8, float32"


def test_budgets_may_be_for_packets():
    rows = runs().rows
    assert chosen(rows, "bits", 20.0, size=COMPACT).name == chosen(rows, "bits", 7.0).name
    assert chosen(rows, "bits", 47.0, size=PACKET).name == chosen(rows, "bits", 7.0).name
    assert chosen(rows, "bits", 20.0, size=PACKET) is None


def test_the_better_of_two_decoders_is_pca_at_its_best():
    rows = runs().rows
    assert chosen(rows, "best_pca", 4.0).error_m.tolist() == chosen(rows, "pca_completed", 4.0).error_m.tolist()
    assert chosen(rows, "best_pca", 3.0).error_m.tolist() == chosen(rows, "pca", 3.0).error_m.tolist()


def test_a_prefix_in_one_code_and_step():
    rows = runs().rows
    assert at_prefix(rows, "int8", 35).tolist() == pytest.approx((at_prefix(rows, "float32", 35) + 0.1).tolist())
    assert len(at_prefix(rows, "entropy", 35, 0.5)) == 2 and not len(at_prefix(rows, "entropy", 35))


def test_the_rate_term_is_told_in_bits():
    (counted, coded), (length, _) = (surrogate(runs(), name)[at] for name, at in (("ovib", BETA), ("bits", 1e-3)))
    assert counted.tolist() == pytest.approx((np.array([100, 120]) / np.log(2)).tolist()) and coded == 256
    assert length.tolist() == [50, 52]


def test_a_mean_size_over_seeds_counts():
    rows = [row("bits", 8, size, 1.0, seed) for seed, size in enumerate((5.0, 7.0))]
    assert best_within(rows, 6.0, lambda row: True) is not None and best_within(rows, 5.9, lambda row: True) is None


def test_one_price_is_best_over_all_budgets():
    assert one_price(runs().rows, BUDGETS) == 1e-3
    assert one_price(runs().rows, (2.0,)) == 4e-3


@pytest.mark.parametrize("n_views", [4, 5])
def test_overheads_are_those_of_packets(n_views):
    full, compact = overheads_bytes(n_views)
    request = CodedRequest({4: "H4", 5: "A5"}[n_views], "entropy", 20, bytes(9), 3.2, 800, 17, 1000)
    assert (full, compact) == (len(pack_coded(request)) - 9, len(pack_compact(request)) - 9) == (20 + 4 * n_views, 13)


def test_models_of_any_length_are_coded_side_by_side(monkeypatch):
    """Fixed-rate models have as many coordinates as they send, and nested ones all."""
    judged = SimpleNamespace(val_error_m=np.ones((1, 3)), test_error_m=np.ones((1, 3)))
    monkeypatch.setattr(bytes_coding, "_judge_prefixes", lambda *_, **__: judged)
    coding, rng = Coding((0.5, 1.0)), np.random.default_rng(0)
    for method, length in (("ovib", 16), ("ard", 8), ("ard", 4)):
        for seed in (0, 1):
            codes = rng.normal(size=(60, length)).astype(np.float32)
            arch = Architecture(n_views=5, latent=length)
            coding.code(method, BETA, seed, Network(Trained(None, None), arch, (length,), codes[:40], codes[40:]))
    assert {key: bits.shape for key, bits in coding.mean_bits().items()} == {("ovib", BETA): (16,)}
    assert len(coding.rows) == 3 * 2 * 5


def test_bits_of_coordinates_add_up_to_the_ideal_length():
    codes = np.random.default_rng(0).normal(size=(500, 6)).astype(np.float32) * [4, 3, 2, 1, 0.5, 0.2]
    table = fit_table("entropy", codes[:400])
    coder = Coder("entropy", table)
    of_coordinates = bits_of(table, codes[400:]).mean(axis=0)
    assert of_coordinates.sum() == pytest.approx(np.mean([coder.ideal_bits(code) for code in codes[400:]]))
    assert np.all(np.diff(of_coordinates) < 0.1)


def test_claims_are_judged_by_what_was_found():
    claims = bytes_claims(runs(), {"k = 35": 30.0, "k = 128": 130.0}, embedded=True)
    assert len(claims) == len(GOALS_M) + 10 and all(claim.own for claim in claims)
    by_words = {claim.statement[:20]: claim for claim in claims}
    assert len({claim.statement for claim in claims}) == len(claims)
    assert by_words["Streams are as short"].verdict == "held"
    assert by_words["Coding and decoding "].verdict == "held"
    against_pca = [claim for claim in claims if "PCA's best" in claim.statement]
    assert [claim.verdict for claim in against_pca] == ["held", "not held"]  # one price is too long at 6 bytes
    alike = [claim.verdict for claim in claims if "Rounding" in claim.statement]
    assert alike == ["held"] * 3
    assert "110 nats = 159 bits, coded 256 bits" in by_words["What the rate term s"].ours
    slow = bytes_claims(runs()._replace(excess_bytes=2.5), {"k = 35": 300.0}, embedded=False)
    assert [claim.verdict for claim in slow if claim.statement[:7] in ("Streams", "Coding ")] == ["not held"] * 2
