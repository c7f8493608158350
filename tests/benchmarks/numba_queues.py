"""Queue replays as Numba event loops: what `tests.benchmarks.scheduler` measures ours against.

All but the last read requests that are sorted and counted in ticks; the last one starts where `run_grid` does.
"""

import numba
import numpy as np


@numba.njit(parallel=True, error_model="numpy")
def numba_shaped(ready, service, position, fields, tick_ms, weights, out):  # type: ignore[no-untyped-def]
    """The shaped rule; the queue is a list of indices in the order of arrival, of which only the waiting are visited.

    Variants that were slower on these traces: fields copied into the queue (by 14 %), fastmath (by 4 to 7 %).
    """
    n_traces, n_requests = ready.shape
    n_settings = weights.shape[0]
    zero, infinite = np.float32(0), np.float32(np.inf)
    for replay in numba.prange(n_traces * n_settings):
        r, p = replay // n_settings, replay % n_settings
        w_v, w_r, w_l, w_a, w_o, w_s = weights[p]
        field, arrival, length, where, waits = fields[r], ready[r], service[r], position[r], out[r, p]
        queue = np.empty(n_requests, np.int32)
        laxity = np.empty(n_requests, np.float32)
        aged = np.empty(n_requests, np.float32)
        overrun = np.empty(n_requests, np.float32)
        n, upcoming, clock = 0, 0, np.int32(0)
        for _ in range(n_requests):
            if n == 0 and arrival[upcoming] > clock:
                clock = arrival[upcoming]
            while upcoming < n_requests and arrival[upcoming] <= clock:
                queue[n] = upcoming
                n += 1
                upcoming += 1
            chosen = 0
            if n > 1:
                low_d = low_v = low_g = low_l = low_a = low_o = infinite
                high_d = high_v = high_g = high_l = high_a = high_o = -infinite
                for i in range(n):
                    j = queue[i]
                    d, v, g = field[j, 0], field[j, 1], field[j, 2]
                    age = np.float32(clock - arrival[j])
                    late = age - field[j, 3]
                    over = late if late > zero else zero
                    lax = over - late
                    o, a = over * field[j, 4], age * field[j, 4]
                    laxity[i], aged[i], overrun[i] = lax, a, o
                    low_d, high_d = min(low_d, d), max(high_d, d)
                    low_v, high_v = min(low_v, v), max(high_v, v)
                    low_g, high_g = min(low_g, g), max(high_g, g)
                    low_l, high_l = min(low_l, lax), max(high_l, lax)
                    low_a, high_a = min(low_a, a), max(high_a, a)
                    low_o, high_o = min(low_o, o), max(high_o, o)
                c_d = w_v / (high_d - low_d) if high_d > low_d else zero
                c_v = w_r / (high_v - low_v) if high_v > low_v else zero
                c_l = w_l / (high_l - low_l) if high_l > low_l else zero
                c_a = w_a / (high_a - low_a) if high_a > low_a else zero
                c_o = w_o / (high_o - low_o) if high_o > low_o else zero
                c_g = w_s / (high_g - low_g) if high_g > low_g else zero
                best = -infinite
                for i in range(n):
                    j = queue[i]
                    score = c_d * field[j, 0] + c_v * field[j, 1] - c_l * laxity[i]
                    score = score + c_a * aged[i] + c_o * overrun[i] - c_g * field[j, 2]
                    if score > best:
                        best, chosen = score, i
            j = queue[chosen]
            waits[where[j]] = np.float32(clock - arrival[j]) * tick_ms[r]
            clock += length[j]
            n -= 1
            for i in range(chosen, n):
                queue[i] = queue[i + 1]


@numba.njit(parallel=True, error_model="numpy")
def numba_heads(ready, service, position, client, voi, tick_ms, V, out):  # type: ignore[no-untyped-def]
    """Base-DPP; linked lines per client, of which only the clients that wait are visited."""
    n_traces, n_requests = ready.shape
    n_settings = V.shape[0]
    n_clients = client.max() + 1
    for replay in numba.prange(n_traces * n_settings):
        r, p = replay // n_settings, replay % n_settings
        arrival, length, where, waits = ready[r], service[r], position[r], out[r, p]
        backlog = np.zeros(n_clients, np.int32)
        head = np.empty(n_clients, np.int32)
        tail = np.empty(n_clients, np.int32)
        following = np.empty(n_requests, np.int32)
        active = np.empty(n_clients, np.int32)
        n, upcoming, clock = 0, 0, np.int32(0)
        for _ in range(n_requests):
            if n == 0 and arrival[upcoming] > clock:
                clock = arrival[upcoming]
            while upcoming < n_requests and arrival[upcoming] <= clock:
                c = client[r, upcoming]
                if backlog[c] == 0:
                    head[c] = upcoming
                    active[n] = c
                    n += 1
                else:
                    following[tail[c]] = upcoming
                tail[c] = upcoming
                backlog[c] += 1
                upcoming += 1
            best, chosen, slot = -np.float32(np.inf), n_requests, 0
            for i in range(n):
                c = active[i]
                j = head[c]
                score = np.float32(backlog[c]) + V[p] * voi[r, j]
                if score > best or (score == best and j < chosen):
                    best, chosen, slot = score, j, i
            waits[where[chosen]] = np.float32(clock - arrival[chosen]) * tick_ms[r]
            clock += length[chosen]
            c = active[slot]
            backlog[c] -= 1
            if backlog[c] == 0:
                n -= 1
                active[slot] = active[n]
            else:
                head[c] = following[chosen]


@numba.njit(parallel=True)
def numba_fifo(ready, service, position, tick_ms, out):  # type: ignore[no-untyped-def]
    """First come, first served."""
    for r in numba.prange(ready.shape[0]):
        clock = np.int32(0)
        for j in range(ready.shape[1]):
            clock = max(clock, ready[r, j])
            out[r, 0, position[r, j]] = np.float32(clock - ready[r, j]) * tick_ms[r]
            clock += service[r, j]


@numba.njit(parallel=True)
def numba_fifo_of_traces(ready_ms, service_ms, valid, out):  # type: ignore[no-untyped-def]
    """First come, first served, from traces in any order: requests are sorted first, equal arrivals by position."""
    for r in numba.prange(ready_ms.shape[0]):
        clock = 0.0
        for j in np.argsort(np.where(valid[r], ready_ms[r], np.inf), kind="mergesort"):
            if valid[r, j]:
                clock = max(clock, ready_ms[r, j])
                out[r, 0, j] = clock - ready_ms[r, j]
                clock += service_ms[r, j]
            else:
                out[r, 0, j] = np.nan
