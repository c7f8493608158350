"""Route replay of VOI-Control in Numba: a loop as one would write it, and one with what no client changes before."""

import jax
import jax.numpy as jnp
import numba
import numpy as np

from ovibjax.control.actions import ACTIONS
from ovibjax.control.isotropic_belief import isotropic
from ovibjax.control.slot_table import tabulate


@numba.njit(parallel=True, cache=False)
def numba_replays(start, drift, rate, delay, latency, predicted, residual, fix_risk, size, numbers, rest, out):
    """The replay, one client at a time, replays dealt to the cores; float32 throughout.

    It knows what the default settings make of the formulas: the error grows linearly, corrections replace the estimate,
    the covariance is isotropic and its trace is all that is needed of it.

    start [S, 5] (error x and y, trace, direction x and y), drift [S, T, 3] (metres, direction x and y), rate [S, T],
    delay and latency [S, T, A], predicted [T, A], residual [T, A, 2], fix_risk [T, A], size [A], numbers [C, 5]
    (prices of bandwidth and delay, threshold, gap, budget), rest: slot, time-out.
    """
    seeds, slots = rate.shape
    actions, candidates = size.shape[0], numbers.shape[0]
    slot_s, timeout_s = rest[0], rest[1]
    tiny, eight, zero = np.float32(2e-6), np.float32(8), np.float32(0)
    for lane in numba.prange(seeds * candidates):
        s, c = lane // candidates, lane % candidates
        price_b, price_d, gap, budget = numbers[c, 0], numbers[c, 1], numbers[c, 3], numbers[c, 4]
        threshold = max(numbers[c, 2], zero)
        ex, ey, trace, way, tx, ty = start[s, 0], start[s, 1], start[s, 2], zero, start[s, 3], start[s, 4]
        pex, pey, ptrace, pway, ptx, pty = ex, ey, trace, way, tx, ty
        arrives, last, bytes_sent, requests = -1, -(1 << 20), zero, 0
        error_sum, risk_sum = zero, zero
        for t in range(slots):
            more = drift[s, t, 0]
            ex += more * tx
            ey += more * ty
            trace += more * (more + way + way)
            way += more
            if arrives >= t:  # a correction under way drifts too
                pex += more * ptx
                pey += more * pty
                ptrace += more * (more + pway + pway)
                pway += more
                if arrives == t:
                    ex, ey, trace, way, tx, ty = pex, pey, ptrace, pway, ptx, pty
            # The choice among actions is looked at only where a request is possible at all.
            if arrives <= t and np.float32(t - last) * slot_s >= gap - np.float32(1e-3) and rate[s, t] > zero:
                risk = np.sqrt(trace)
                per_byte = price_b * eight / rate[s, t]
                best, action = threshold, -1
                for a in range(actions):
                    if bytes_sent + size[a] <= budget:
                        value = max(risk - predicted[t, a], zero) - per_byte * size[a] - price_d * delay[s, t, a]
                        if value > best:
                            best, action = value, a
                if action >= 0:
                    requests += 1
                    bytes_sent += size[action]
                    last = t
                    wait = eight * size[action] / rate[s, t] + latency[s, t, action]
                    pex, pey, ptrace, pway, ptx, pty = ex, ey, trace, way, tx, ty
                    if wait <= timeout_s:
                        pex, pey = residual[t, action, 0], residual[t, action, 1]
                        ptrace, pway = fix_risk[t, action] * fix_risk[t, action] + tiny, zero
                        ptx, pty = drift[s, t, 1], drift[s, t, 2]
                    flight = int(min(wait, timeout_s) / slot_s)
                    arrives = t + flight
                    if flight == 0:
                        ex, ey, trace, way, tx, ty = pex, pey, ptrace, pway, ptx, pty
            error_sum += np.sqrt(ex * ex + ey * ey)
            risk_sum += np.sqrt(trace)
        out[lane, 0], out[lane, 1] = error_sum / np.float32(slots), risk_sum / np.float32(slots)
        out[lane, 2], out[lane, 3] = np.float32(requests), bytes_sent


@numba.njit(parallel=True, cache=False)
def numba_hoisted(start, drift, key, trip, table, size, numbers, rest, out):
    """The same with all that does not depend on the client computed before it, as ours has it.

    A belief is the time since its correction and three numbers that the correction brings, see
    `control.isotropic_belief`; an action is worth it above a risk that no client changes.

    start [S, 3] (square of the risk, square of the error, error along the direction of drift), drift [S, T] metres,
    key [S, T, A, 3] (residual, infinite where the link is down; transmission time; delay), trip [S, T, A] (twice the
    slots until the answer, one more where it is not lost), table [S, T, A, 4] (risk of the position, then as `start`),
    size [A], numbers [C, 5], rest: slot.
    """
    seeds, slots = drift.shape
    actions, candidates = size.shape[0], numbers.shape[0]
    slot_s, zero = rest[0], np.float32(0)
    for lane in numba.prange(seeds * candidates):
        s, c = lane // candidates, lane % candidates
        price_b, price_d, gap, budget = numbers[c, 0], numbers[c, 1], numbers[c, 3], numbers[c, 4]
        threshold, rests = max(numbers[c, 2], zero), int(np.ceil((gap - np.float32(1e-3)) / slot_s))
        square, off, along, way = start[s, 0], start[s, 1], start[s, 2], zero
        psquare, poff, palong, pway = square, off, along, way
        free, ready, landing = 0, 0, -1
        bytes_sent, requests = zero, 0
        error_sum, risk_sum = zero, zero
        for t in range(slots):
            way += drift[s, t]
            pway += drift[s, t]
            if landing == t:
                square, off, along, way = psquare, poff, palong, pway
            risk = np.sqrt(square + way * way)
            if t >= free and t >= ready:
                best, action = risk - threshold, -1
                for a in range(actions):
                    if bytes_sent + size[a] <= budget:
                        worth = key[s, t, a, 0] + price_b * key[s, t, a, 1] + price_d * key[s, t, a, 2]
                        if worth < best:
                            best, action = worth, a
                if action >= 0:
                    requests += 1
                    bytes_sent += size[action]
                    free, ready = t + trip[s, t, action] // 2, t + rests
                    if trip[s, t, action] % 2 == 1 and table[s, t, action, 0] < risk:
                        psquare, poff, palong = table[s, t, action, 1], table[s, t, action, 2], table[s, t, action, 3]
                        pway, landing = zero, free
                        if free == t:
                            square, off, along, way = psquare, poff, palong, pway
                            risk = np.sqrt(square)
            error_sum += np.sqrt(max(off + way * (along + along + way), zero))
            risk_sum += risk
        out[lane, 0], out[lane, 1] = error_sum / np.float32(slots), risk_sum / np.float32(slots)
        out[lane, 2], out[lane, 3] = np.float32(requests), bytes_sent


def hoisted(inputs: tuple, arrays: tuple):
    """Arguments of `numba_hoisted`."""
    draws, route, env, _ = inputs
    planned = jnp.zeros(draws.rate_bps.shape, bool)
    tables = jax.vmap(lambda draws, planned: tabulate(draws, route, planned, env, ACTIONS))(draws, planned)
    first = jax.vmap(lambda belief: isotropic(belief, env.drift))(draws.start)
    tables, first = jax.device_get((tables, first))
    down = np.isinf(tables.transmit_s)
    key = (np.where(down, np.inf, tables.predicted_m), np.where(down, 0, tables.transmit_s), tables.delay_s)
    fixed = (tables.fix_risk_m, tables.fixed.fixed_m2, tables.fixed.error_a, tables.fixed.error_b)
    key, table = (np.ascontiguousarray(np.stack(parts, -1), np.float32) for parts in (key, fixed))
    start = np.ascontiguousarray(np.stack([first.fixed_m2, first.error_a, first.error_b], -1))
    size, control, rest, out = arrays[-4:]
    drift, trip = np.array(draws.odometry.advance_m), np.array(tables.trip)
    return start, drift, key, trip, table, size, control, rest, np.zeros_like(out)


def for_numba(inputs: tuple):
    """The same inputs as plain arrays, and a place for the result."""
    draws, route, env, tried = jax.device_get(inputs)
    numbers = (tried.prices.bandwidth_m_per_s, tried.prices.delay_m_per_s, tried.threshold_m, tried.min_gap_s)
    control = np.ascontiguousarray(np.stack([*numbers, tried.budget_bytes], -1))
    rest = np.array([env.slot_s, env.timeout_s], np.float32)
    first, odometry = draws.start, draws.odometry
    trace = first.cov_xx_m2 + first.cov_yy_m2
    begin = (first.error_x_m, first.error_y_m, trace, first.toward_x, first.toward_y)
    start = np.ascontiguousarray(np.stack(begin, -1))
    drift = np.ascontiguousarray(np.stack([odometry.advance_m, odometry.toward_x, odometry.toward_y], -1))
    out = np.zeros((len(start) * len(control), 4), np.float32)
    world = (start, drift, draws.rate_bps, draws.delay_s, draws.latency_s)
    sizes = ACTIONS.payload_bytes
    table = (np.asarray(leaf) for leaf in (route.predicted_m, route.residual_m, route.risk_m))
    return (*world, *table, sizes, control, rest, out)
