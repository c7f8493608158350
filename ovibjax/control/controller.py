"""What a request may cost a client: prices, thresholds, budgets (paper, Section "View-Rate Selection").

A client that asks the edge for its position pays in transmission, energy and delay. These numbers say at which exchange
rates, from which gain on, and how much it may spend on a route.
"""

import math
from typing import Any, NamedTuple

import jax.numpy as jnp

from ovibjax.control.actions import ActionSet
from ovibjax.control.belief import CORRECTIONS
from ovibjax.control.voi import Prices
from ovibjax.errors import InputError

PAPER_BUDGET_KB = 2.1
"""Payload per route, KB of 1,024 bytes (paper, Section "View-Rate Selection")."""

PERIODIC_S = 16.0
"""Periodic sends a request this often (paper, same section, as the next four)."""

FIXED_FRONT_RISK_M, FIXED_FRONT_GAP_S = 8.0, 1.0
"""Fixed-front asks above this local risk, with this minimum gap."""

UNCERTAINTY_RISK_M, UNCERTAINTY_GAP_S = 6.0, 6.0
"""Uncertainty asks above this local risk, with this minimum gap."""

LAMBDA_B_M_PER_S, LAMBDA_D_M_PER_S = 0.135, 497.3
"""VOI-Control's prices of transmission and delay. The paper publishes none: these are what the tuning seeds of the full
preset selected (risk 9.8 m, at most 2.09 KB; where corrections are fused 0.26 and 421 m/s, 9.1 m and 1.94 KB)."""

THRESHOLD_M, MIN_GAP_S = 7.34, 7.9
"""Threshold and gap of the variant `voi_gap`, selected alike."""

GAP_LAMBDA_B_M_PER_S, GAP_LAMBDA_D_M_PER_S = 1.7, 5.45
"""Prices of that variant, selected with them; `make_controller` takes those of VOI-Control unless it is given these."""

GATE_SIGMA = 3.0
"""An innovation gate as navigation filters have it, for those who ask for one. The paper has none."""


class FixedRules(NamedTuple):
    """Numbers of the policies that follow a fixed rule; leaves.

    Attributes:
        period_s: Periodic asks this often.
        fixed_front_risk_m: Fixed-front asks above this risk ...
        fixed_front_gap_s: ... and not sooner after the last request.
        uncertainty_risk_m: Uncertainty asks above this risk ...
        uncertainty_gap_s: ... and not sooner after the last request.
    """

    period_s: Any
    fixed_front_risk_m: Any
    fixed_front_gap_s: Any
    uncertainty_risk_m: Any
    uncertainty_gap_s: Any


class Controller(NamedTuple):
    """Numbers of the controller; leaves.

    Attributes:
        prices: lambda_b, lambda_e, lambda_d.
        threshold_m: the variant `voi_gap` asks only if the net VOI exceeds this ...
        min_gap_s: ... and not sooner after its last request.
        budget_bytes: payload allowed over the route.
        energy_j: [A] endpoint energy E(a) of each action.
        energy_budget_j: energy allowed over the route.
        available: [A] bool, actions that may be chosen.
        correction: int32, what a correction does, which of `belief.CORRECTIONS`.
        gate_sigma: innovation gate of corrections; infinity is none.
        rules: numbers of the other policies.
    """

    prices: Prices
    threshold_m: Any
    min_gap_s: Any
    budget_bytes: Any
    energy_j: Any
    energy_budget_j: Any
    available: Any
    correction: Any
    gate_sigma: Any
    rules: FixedRules


# Eight numbers, each of which a caller may want to change alone.
def make_controller(
    actions: ActionSet,
    bandwidth_m_per_s: float = LAMBDA_B_M_PER_S,
    delay_m_per_s: float = LAMBDA_D_M_PER_S,
    threshold_m: float = THRESHOLD_M,
    min_gap_s: float = MIN_GAP_S,
    budget_kb: float = PAPER_BUDGET_KB,
    correction: str = "replace",
    gate_sigma: float = math.inf,
) -> Controller:
    """A controller with the paper's rules, no price on energy, and every action available.

    Args:
        actions: the action set.
        bandwidth_m_per_s: lambda_b.
        delay_m_per_s: lambda_d.
        threshold_m: net VOI above which `voi_gap` asks.
        min_gap_s: shortest time between its requests.
        budget_kb: payload per route, KB of 1,024 bytes.
        correction: one of `belief.CORRECTIONS`.
        gate_sigma: innovation above which a correction is discarded.

    Returns:
        Float32 leaves.

    Raises:
        InputError: an unknown correction.
    """
    if correction not in CORRECTIONS:
        raise InputError(f"correction {correction!r} is unknown; it must be one of {', '.join(CORRECTIONS)}")
    number = jnp.float32
    return Controller(
        prices=Prices(number(bandwidth_m_per_s), number(0.0), number(delay_m_per_s)),
        threshold_m=number(threshold_m),
        min_gap_s=number(min_gap_s),
        budget_bytes=number(budget_kb * 1024.0),
        energy_j=jnp.zeros(len(actions), jnp.float32),
        energy_budget_j=number(jnp.inf),
        available=jnp.ones(len(actions), bool),
        correction=jnp.int32(CORRECTIONS.index(correction)),
        gate_sigma=number(gate_sigma),
        rules=FixedRules(
            period_s=number(PERIODIC_S),
            fixed_front_risk_m=number(FIXED_FRONT_RISK_M),
            fixed_front_gap_s=number(FIXED_FRONT_GAP_S),
            uncertainty_risk_m=number(UNCERTAINTY_RISK_M),
            uncertainty_gap_s=number(UNCERTAINTY_GAP_S),
        ),
    )
