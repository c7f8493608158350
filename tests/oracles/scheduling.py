"""One edge server as a plain event loop in Python floats: the five policies, written from the paper."""

import math

PAPER_V = 8.0
PAPER_WEIGHTS = (3.2, 1.2, 1.2, 1.4, 0.6, 0.1)
PAPER_VALUE = (0.1, 1.8, 0.22, 0.006)
FIELDS = (
    *("client", "ready_ms", "service_ms", "service_est_ms", "deadline_ms", "voi_m"),
    *("drift_m_per_s", "risk_m", "delay_est_ms", "urgency", "valid"),
)


def scheduling_value(request, value=PAPER_VALUE):
    """Eq. scheduler_value."""
    floor, drift, risk, delay = value
    return max(
        floor,
        request["urgency"]
        * (
            request["voi_m"]
            + drift * request["drift_m_per_s"]
            + risk * request["risk_m"]
            - delay * request["delay_est_ms"]
        ),
    )


def normalized(values):
    """Min-max normalization, zero where the range is zero."""
    low, high = min(values), max(values)
    return [(u - low) / (high - low) if high > low else 0.0 for u in values]


def scores(queued, clock, weights=PAPER_WEIGHTS, value=PAPER_VALUE):
    """Eq. voi_scheduler_impl for every queued request."""
    w_v, w_r, w_l, w_a, w_o, w_s = weights
    v = [scheduling_value(j, value) for j in queued]
    g = [j["service_est_ms"] for j in queued]
    due = [j["ready_ms"] + j["deadline_ms"] for j in queued]
    laxity = [max(d - clock - s, 0.0) for d, s in zip(due, g, strict=True)]
    age = [max(clock - j["ready_ms"], 0.0) / j["deadline_ms"] for j in queued]
    overrun = [max(clock + s - d, 0.0) / j["deadline_ms"] for j, d, s in zip(queued, due, g, strict=True)]
    per_service, value_n = normalized([a / s for a, s in zip(v, g, strict=True)]), normalized(v)
    laxity_n, age_n, overrun_n = normalized(laxity), normalized(age), normalized(overrun)
    short = normalized([-s for s in g])
    return [
        w_v * per_service[i]
        + w_r * value_n[i]
        + w_l * (1.0 - laxity_n[i])
        + w_a * age_n[i]
        + w_o * overrun_n[i]
        + w_s * short[i]
        for i in range(len(queued))
    ]


def requests_of(trace):
    """Valid requests of a trace of arrays, as dictionaries that know their index."""
    columns = {name: [float(x) for x in getattr(trace, name)] for name in FIELDS}
    every = [{name: columns[name][i] for name in FIELDS} | {"index": i} for i in range(len(columns["valid"]))]
    return [j for j in every if j["valid"]]


def priorities(policy, queued, clock, V, weights, value):
    """Priority of each queued request, or None where the policy may not serve it."""
    if policy == "fifo":
        return [-j["ready_ms"] for j in queued]
    if policy == "edf":
        return [-(j["ready_ms"] + j["deadline_ms"]) for j in queued]
    if policy == "voi_lyapunov":
        return scores(queued, clock, weights, value)
    V = 0.0 if policy == "maxweight" else V
    found = []
    for j in queued:
        line = [i for i in queued if i["client"] == j["client"]]
        head = min(line, key=lambda i: (i["ready_ms"], i["index"]))
        found.append(len(line) + V * j["voi_m"] if head is j else None)
    return found


def served_first(policy, queued, priority, ties="arrival"):
    """The queued request of largest priority; equal ones by arrival, client or last arrival, FIFO always by arrival."""
    best = max(p for p in priority if p is not None)
    equal = [j for p, j in zip(priority, queued, strict=True) if p == best]

    def arrival(j):
        return j["ready_ms"], j["index"]

    if policy == "fifo" or ties == "arrival":
        return min(equal, key=arrival)
    if ties == "client":
        return min(equal, key=lambda j: (j["client"], *arrival(j)))
    assert ties == "last"
    return max(equal, key=arrival)


def replay(trace, policy, V=PAPER_V, weights=PAPER_WEIGHTS, value=PAPER_VALUE, ties="arrival"):
    """Serve every valid request.

    Returns start times by index, the order served, and the smallest gap between the served request's priority and a
    different one's: below rounding, the choice is not determined.
    """
    pending = requests_of(trace)
    starts, order, gap, clock = {}, [], math.inf, -math.inf
    while pending:
        clock = max(clock, min(j["ready_ms"] for j in pending))
        queued = [j for j in pending if j["ready_ms"] <= clock]
        priority = priorities(policy, queued, clock, V, weights, value)
        allowed = [p for p in priority if p is not None]
        best = max(allowed)
        gap = min([gap, *(best - p for p in allowed if p != best)])
        served = served_first(policy, queued, priority, ties)
        starts[served["index"]] = clock
        order.append(served["index"])
        clock += served["service_ms"]
        pending.remove(served)
    return starts, order, gap


def group_metrics(members, starts, uplink_ms, value=PAPER_VALUE):
    """Edge and end-to-end p95, means of stale-feedback penalty and of weighted cost, end to end and at the edge."""
    if not members:
        return (math.nan,) * 5
    edge = {j["index"]: starts[j["index"]] + j["service_ms"] - j["ready_ms"] for j in members}
    e2e = {i: float(uplink_ms[i]) + latency for i, latency in edge.items()}
    stale = [j["drift_m_per_s"] * e2e[j["index"]] / 1000.0 for j in members]
    cost = [scheduling_value(j, value) * e2e[j["index"]] / j["deadline_ms"] for j in members]
    edge_cost = [scheduling_value(j, value) * edge[j["index"]] / j["deadline_ms"] for j in members]
    return (
        percentile_95(list(edge.values())),
        percentile_95(list(e2e.values())),
        sum(stale) / len(stale),
        sum(cost) / len(cost),
        sum(edge_cost) / len(edge_cost),
    )


def percentile_95(values):
    """Linear interpolation between order statistics."""
    ordered = sorted(values)
    at = 0.95 * (len(ordered) - 1)
    low = math.floor(at)
    high = min(low + 1, len(ordered) - 1)
    return ordered[low] + (at - low) * (ordered[high] - ordered[low])


def top_tenth(requests, value=PAPER_VALUE):
    """The tenth with the largest scheduling values, rounded up."""
    count = math.ceil(len(requests) / 10)
    return sorted(requests, key=lambda j: -scheduling_value(j, value))[:count]
