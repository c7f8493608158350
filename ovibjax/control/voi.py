"""Value of information of an edge request, gross and net of its costs (paper, "Net VOI and Online Action")."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.link.latency import transmit_s


class Prices(NamedTuple):
    """What convert costs into metres of localization risk; leaves.

    Attributes:
        bandwidth_m_per_s: lambda_b, per second of transmission.
        energy_m_per_j: lambda_e, per joule at the endpoint.
        delay_m_per_s: lambda_d, per second of queueing, service and return.
    """

    bandwidth_m_per_s: jax.Array
    energy_m_per_j: jax.Array
    delay_m_per_s: jax.Array


def gross_voi(local_risk: jax.Array, residual: jax.Array) -> jax.Array:
    """Predicted reduction of risk [L - g]^+ in metres (paper, eq. "gross_voi").

    Args:
        local_risk: [...] local risk, m.
        residual: [...] predicted residual after the correction, m.

    Returns:
        [...] metres, not negative.
    """
    return jnp.maximum(local_risk - residual, 0.0)


def request_cost_m(link_s: jax.Array, delay_s: jax.Array, energy_j: jax.Array, prices: Prices) -> jax.Array:
    """Priced transmission time, energy and delay of a request: what eq. "net_voi" subtracts.

    Args:
        link_s: [...] transmission time, see `link.latency.transmit_s`.
        delay_s: [...] predicted queueing, service and return delay, without uplink transmission.
        energy_j: [...] estimated endpoint energy E(a).
        prices: lambda_b, lambda_e, lambda_d.

    Returns:
        [...] metres; infinite where transmission never ends, whatever the price.
    """
    down = jnp.isinf(link_s)
    cost = prices.bandwidth_m_per_s * jnp.where(down, 0.0, link_s)
    cost = cost + prices.energy_m_per_j * energy_j + prices.delay_m_per_s * delay_s
    return jnp.where(down, jnp.inf, cost)


def net_voi(
    local_risk: jax.Array,
    residual: jax.Array,
    payload_bytes: jax.Array,
    rate_bps: jax.Array,
    delay_s: jax.Array,
    energy_j: jax.Array,
    prices: Prices,
) -> jax.Array:
    """Net VOI: gross VOI less the priced transmission time, energy and delay (paper, eq. "net_voi").

    Args:
        local_risk: [...] local risk, m.
        residual: [...] predicted residual, m.
        payload_bytes: [...] request size b(a).
        rate_bps: [...] uplink rate R, bit/s.
        delay_s: [...] predicted queueing, service and return delay, without uplink transmission.
        energy_j: [...] estimated endpoint energy E(a).
        prices: lambda_b, lambda_e, lambda_d.

    Returns:
        [...] metres; minus infinity where the rate is zero, whatever the price.
    """
    cost = request_cost_m(transmit_s(payload_bytes, rate_bps), delay_s, energy_j, prices)
    return gross_voi(local_risk, residual) - cost
