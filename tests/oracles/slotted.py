"""The slotted scheduler in plain Python, one subset, slot and client after another, exact where the numbers are."""

import itertools


def subsets(n):
    """Every choice of x, client 0 changing fastest."""
    return [x[::-1] for x in itertools.product((0, 1), repeat=n)]


def fits(x, payload, service, payload_budget, service_budget):
    """Both budgets of eq. voi_scheduler."""
    used = [sum(c for take, c in zip(x, cost, strict=True) if take) for cost in (payload, service)]
    return used[0] <= payload_budget and used[1] <= service_budget


def best_subset(weight, payload, service, payload_budget, service_budget):
    """First of the best subsets with positive weights only; nothing where nothing fits."""
    best, chosen = -1.0, (0,) * len(weight)
    for x in subsets(len(weight)):
        if any(take and not w > 0 for take, w in zip(x, weight, strict=True)):
            continue
        total = sum(w for take, w in zip(x, weight, strict=True) if take)
        if fits(x, payload, service, payload_budget, service_budget) and total > best:
            best, chosen = total, x
    return list(chosen)


def solve(backlog, voi, payload, service, v, payload_budget, service_budget):
    """Eq. voi_scheduler over R_t."""
    weight = [q + v * nu if q > 0 else 0.0 for q, nu in zip(backlog, voi, strict=True)]
    return best_subset(weight, payload, service, payload_budget, service_budget)


def update_queue(backlog, x, arrivals):
    """Eq. queue."""
    return [max(q - served, 0) + a for q, served, a in zip(backlog, x, arrivals, strict=True)]


def simulate(draws, backlog, v, rate, serve_empty, offset, price, system):
    """Sums over slots of utility, gap (benchmark's dual value less the slot's) and backlog, and the queues left.

    `draws` are (state, uniforms) per slot; `system` is (payload, service, voi, payload_budget, service_budget).
    """
    payload, service, voi, *budgets = system
    utility = gap = total = 0.0
    for state, uniforms in draws:
        nu = [float(value) for value in voi[state]]
        costs = (payload[state].tolist(), service[state].tolist(), *map(int, budgets))
        weight = [
            q + v * (value - shift) if q > 0 or serve_empty else 0.0
            for q, value, shift in zip(backlog, nu, offset, strict=True)
        ]
        x = best_subset(weight, *costs)
        worth = [value + p for value, p in zip(nu, price, strict=True)]
        dual = sum(w for take, w in zip(best_subset(worth, *costs), worth, strict=True) if take)
        utility += sum(value for take, value in zip(x, nu, strict=True) if take)
        gap += dual - sum(w for take, w in zip(x, worth, strict=True) if take)
        gap += sum(p for take, p, q in zip(x, price, backlog, strict=True) if take and q == 0)
        total += sum(backlog)
        backlog = update_queue(backlog, x, [int(u < r) for u, r in zip(uniforms, rate, strict=True)])
    return utility, gap, total, backlog


def dual_value(price, rate, system):
    """Expected best of sum x (nu + price) over equally likely states, less price times rate: bounds every policy."""
    payload, service, voi, *budgets = system
    total = 0.0
    for state in range(len(voi)):
        worth = [float(nu) + float(p) for nu, p in zip(voi[state], price, strict=True)]
        x = best_subset(worth, payload[state].tolist(), service[state].tolist(), *map(int, budgets))
        total += sum(w for take, w in zip(x, worth, strict=True) if take)
    return total / len(voi) - sum(float(p) * float(r) for p, r in zip(price, rate, strict=True))
