"""Rows and claims of the system by code, on numbers made up by hand."""

import numpy as np
import pytest
import xarray

from ovibjax.cards.bytes_system import CODES, METRICS, RULES, SYSTEM_KS, system_claims, system_rows, with_prices
from ovibjax.control.voi import Prices


@pytest.fixture
def found():
    """Three seeds: entropy-coded routes are 0.5 m better than those with floats, those of int8 1 m worse."""
    dims, shape = ("seed", "code", "k"), (3, len(CODES), len(SYSTEM_KS))
    base = np.arange(3.0)[:, None, None] + np.zeros(shape)
    worse = np.array([0.0, 1.0, -0.5])[None, :, None]
    values = dict.fromkeys(METRICS, base + 1)
    values |= {"mean_route_m": base + 9 + worse, "kb": base + np.array([4.0, 1.0, 1.0])[None, :, None]}
    data = {name: (dims, value) for name, value in values.items()}
    of_queue = np.broadcast_to(base[..., None, None], (*shape, 1, 2)) + np.array([50.0, 20.0])
    data |= {
        "top_edge_p95_ms": ((*dims, "V", "scheduler"), of_queue),
        "unserved": ((*dims, "V", "scheduler"), 0 * of_queue),
    }
    coords = {"seed": [5, 6, 7], "code": list(CODES), "k": list(SYSTEM_KS), "V": [8.0], "scheduler": list(RULES)}
    prices = np.arange(6.0).reshape(len(CODES), 2)
    return with_prices(xarray.Dataset(data, coords=coords), Prices(prices, 0 * prices, prices + 100))


def test_a_claim_per_code_is_held_where_routes_are_more_accurate(found):
    int8, entropy = system_claims(found)
    assert (int8.verdict, entropy.verdict) == ("not held", "held") and int8.own
    assert "k = 16: 0.50 ± 0.00 m (float32 10.00 ± 2.48 m, 2.0 ± 2.5 requests, 5.00 ± 2.48 KB" in entropy.ours
    assert "edge p95 51 ms with FIFO, 21 ms with VOI-Lyapunov" in entropy.ours


def test_rows_hold_every_seed_once(found):
    rows = system_rows(found)
    assert len(rows) == 3 * len(CODES) * len(SYSTEM_KS)
    (row,) = (row for row in rows if (row["code"], row["k"], row["seed"]) == ("int8", 32, 6))
    assert (row["mean_route_m"], row["kb"], row["edge_p95_ms_fifo"]) == ("11", "2", "51")
    assert (row["lambda_b"], row["lambda_d"], row["unserved_fifo"]) == ("3", "103", "0")
