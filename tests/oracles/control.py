"""Route replay in float64 NumPy: one slot after another, covariances as 2x2 matrices, one request object under way.

The world's draws (drift, rate, delays) come in as arrays; what the controller makes of them is written out here.
"""

import math

import numpy as np

VIEWS = {"F": 1, "FS": 3, "H4": 4, "A5": 5}
FOLLOW_VOI = ("budgeted_periodic", "random", "oracle_action")


def action_list(modes=("F", "FS", "H4", "A5"), prefixes=(16, 32)):
    """(mode, prefix, bytes) of each action: 4 k + 20-byte header + 4 per view."""
    return [(mode, k, 4 * k + 20 + 4 * VIEWS[mode]) for mode in modes for k in prefixes]


def walk(along_share, yaw, normal):
    """Increment of a random walk of unit mean square and its covariance, drawn in the frame of travel."""
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    local = np.diag([along_share, 1 - along_share])
    return turn @ (np.sqrt(np.diag(local)) * normal), turn @ local @ turn.T


def drifted(belief, t, draws, drift):
    """A belief (error, covariance, metres accumulated since the correction, direction) after the odometry of slot t."""
    error, cov, accumulated, toward = belief
    scale, power = drift["scale"], drift["power"]
    after = accumulated + draws["advance"][t]
    root_before, root_after = (scale * (s / scale) ** power for s in (accumulated, after))
    growth = root_after**2 - root_before**2
    if drift["walks"]:
        error = error + math.sqrt(growth) * draws["walk"][t]
    else:
        error = error + (root_after - root_before) * toward
    return error, cov + growth * draws["walk_cov"][t], after, toward


def noise_of(risk):
    """Isotropic covariance whose trace is the square of a risk; a risk of zero counts as a millimetre."""
    return (risk**2 / 2 + 1e-6) * np.eye(2)


def kalman(error, cov, residual, risk, gate):
    """Textbook update with a position measurement; errors are estimate minus truth."""
    noise = noise_of(risk)
    innovation = residual - error
    total = cov + noise
    if innovation @ np.linalg.solve(total, innovation) > gate**2:
        return error, cov, False
    gain = cov @ np.linalg.inv(total)
    return error + gain @ innovation, (np.eye(2) - gain) @ cov, True


def correct(belief, residual, risk, toward, control):
    """A belief after a position from the edge of some risk, and whether it was used."""
    error, cov, accepted = kalman(belief[0], belief[1], residual, risk, control["gate"])
    if control["correction"] == "replace" and risk >= math.sqrt(np.trace(belief[1])):
        accepted = False
    if not accepted:
        return belief, False
    if control["correction"] != "kalman":
        error, cov = residual, noise_of(risk)
    return (error, cov, 0.0, toward), True


def net_voi(risk, residual, size, rate, delay, energy, prices):
    """Predicted reduction of risk, less what it costs; nothing can be sent over a dead link."""
    if rate <= 0:
        return -math.inf
    price_b, price_e, price_d = prices
    return max(risk - residual, 0.0) - price_b * 8 * size / rate - price_e * energy - price_d * delay


def best(values, allowed):
    """First of the highest values among those allowed; None if there are none."""
    usable = [a for a in range(len(values)) if allowed[a] and values[a] > -math.inf]
    return max(usable, key=lambda a: (values[a], -a)) if usable else None


def planned_slots(policy, slots, slot_s, period_s, phase, rank, voi_slots):
    """Set of the slots that a policy has planned ahead."""
    count = len(voi_slots)
    if policy == "periodic":
        period = max(round(period_s / slot_s), 1)
        return set(range(period - 1 - math.floor(phase * period), slots, period))
    if policy == "budgeted_periodic":  # the slot that holds the middle of each of `count` equal parts
        return {math.ceil((2 * j + 1) * slots / (2 * count)) - 1 for j in range(count)}
    if policy == "random":
        return {t for t in range(slots) if rank[t] < count}
    return set(voi_slots) if policy == "oracle_action" else set()


def decide(policy, t, seen, control, actions):
    """Action that a policy asks with in this slot, or None."""
    risk, waiting, since, allowed = seen["risk"], seen["waiting"], seen["since"], seen["allowed"]
    compact = {mode: a for a, (mode, _, _) in reversed(list(enumerate(actions)))}
    values = [
        net_voi(
            risk, seen["predicted"][a], size, seen["rate"], seen["delay"][a], control["energy"][a], control["prices"]
        )
        for a, (_, _, size) in enumerate(actions)
    ]
    if policy in ("voi", "voi_gap"):
        threshold, gap = (control["threshold"], control["gap"]) if policy == "voi_gap" else (0.0, 0.0)
        action = best(values, allowed)
        if action is None or waiting or since < gap - 1e-6:
            return None
        return action if values[action] > max(threshold, 0.0) else None
    if policy == "oracle_action":
        costs = [max(risk - seen["predicted"][a], 0.0) - value for a, value in enumerate(values)]
        return best([-seen["realised"][a] - cost for a, cost in enumerate(costs)], allowed) if seen["due"] else None
    action = compact["F" if policy == "fixed_front" else "FS"]
    if policy in ("fixed_front", "uncertainty"):
        level, gap = control[policy]
        due = risk > level and since >= gap - 1e-6 and not waiting
    else:
        due = seen["due"]
    return action if due and allowed[action] else None


def follow(policy, draws, route, env, control, actions, due, adapter=None):
    """Replay one policy whose planned slots are the set `due`; a dict of per-slot lists."""
    answer = None
    belief = np.array(draws["start_error"]), np.array(draws["start_cov"]), 0.0, np.array(draws["start_toward"])
    coming, arrives, last = None, None, None
    sent_bytes, used = 0.0, 0.0
    out = {name: [] for name in ("sent", "action", "payload", "error", "risk_before", "risk", "latency", "voi")}
    out |= {"accepted": [], "lost": [], "superseded": [], "flight": []}
    for t in range(len(draws["rate"])):
        belief = drifted(belief, t, draws, env["drift"])
        if coming is not None:
            coming = drifted(coming, t, draws, env["drift"])
            if arrives == t:
                belief, coming = coming, None
                if answer is not None:
                    adapter.hear(*answer)
        fits = [
            control["available"][a]
            and used + control["energy"][a] <= control["energy_budget"]
            and (policy == "oracle_action" or sent_bytes + size <= control["budget"])
            for a, (_, _, size) in enumerate(actions)
        ]
        risk = math.sqrt(np.trace(belief[1]))
        seen = {
            "risk": risk,
            "waiting": coming is not None,
            "since": math.inf if last is None else (t - last) * env["slot_s"],
            "allowed": fits,
            "predicted": adapter.predicted(route["context"][t], route["predicted"][t])
            if adapter
            else route["predicted"][t],
            "realised": np.linalg.norm(route["residual"][t], axis=-1),
            "rate": draws["rate"][t],
            "delay": draws["delay"][t],
            "due": t in due,
        }
        action, asked = decide(policy, t, seen, control, actions), None
        if adapter and action is not None:
            action, asked = adapter.choose(t, route["context"][t], action, seen)
        out["sent"].append(action is not None)
        out["risk_before"].append(risk)
        if action is None:
            for name in ("action", "payload", "latency", "voi", "flight"):
                out[name].append(0.0)
            for name in ("accepted", "lost", "superseded"):
                out[name].append(False)
        else:
            size, rate = actions[action][2], draws["rate"][t]
            latency = draws["latency"][t][action] + (8 * size / rate if rate > 0 else math.inf)
            lost = latency > env["timeout_s"]
            predicted, measured = seen["predicted"][action], route["residual"][t][action]
            fix_risk = route["risk"][t][action]
            corrected, accepted = correct(belief, measured, fix_risk, draws["toward"][t], control)
            flight = math.floor(min(latency, env["timeout_s"]) / env["slot_s"])
            out["superseded"].append(coming is not None)
            answer = None if adapter is None or lost else (asked, fix_risk, measured - belief[0])
            coming, arrives, last = belief if lost else corrected, t + flight, t
            if flight == 0 and answer is not None:
                adapter.hear(*answer)
            if flight == 0:
                belief, coming = coming, None
            sent_bytes, used = sent_bytes + size, used + control["energy"][action]
            voi = net_voi(
                risk, predicted, size, rate, draws["delay"][t][action], control["energy"][action], control["prices"]
            )
            values = {"action": action, "payload": size, "latency": latency, "voi": voi, "flight": flight}
            for name, value in (values | {"accepted": accepted, "lost": lost}).items():
                out[name].append(value)
        out["error"].append(float(np.linalg.norm(belief[0])))
        out["risk"].append(math.sqrt(np.trace(belief[1])))
    return {name: np.array(values) for name, values in out.items()}


def replay(policy, draws, route, env, control, actions):
    """Replay any of the policies; those that follow VOI-Control replay it first."""
    asked = []
    if policy in FOLLOW_VOI:
        asked = np.flatnonzero(follow("voi", draws, route, env, control, actions, set())["sent"]).tolist()
    slots = len(draws["rate"])
    due = planned_slots(policy, slots, env["slot_s"], control["period"], draws["phase"], draws["rank"], asked)
    return follow(policy, draws, route, env, control, actions, due)


def most_similar_other(query, reference, own, places, elsewhere):
    """Row of the most similar reference of each query, skipping row `own`, the first of equals; and how distinct it is.

    That is 1 - d / d', d = 1 - cosine, d' that of the most similar reference further than `elsewhere` from the row, or
    of a cosine of -1 if there is none.
    """
    found, distinct = [], []
    for q, skip in zip(np.asarray(query, np.float64), own, strict=True):
        scores = {}
        for row, r in enumerate(np.asarray(reference, np.float64)):
            if row != skip:
                length = np.linalg.norm(r) * np.linalg.norm(q)
                scores[row] = q @ r / length if length > 0 else 0.0
        best = max(scores, key=lambda row: (scores[row], -row))
        far = [scores[row] for row in scores if math.dist(places[row], places[best]) > elsewhere]
        found.append(best)
        near, rival = 1.0 - scores[best], 1.0 - max([-1.0, *far])
        distinct.append(1.0 - near / rival if rival > 1e-12 else 0.0)
    return np.array(found), np.array(distinct)


def survey(positions, yaw, drive, spacing, turn_deg):
    """Frames kept when one is kept per `spacing` metres travelled, or per so many degrees turned, within each drive."""
    kept = []
    for d in dict.fromkeys(drive):
        rows = [i for i in range(len(drive)) if drive[i] == d]
        way, turned = math.inf, 0.0
        for before, row in zip([None, *rows], rows, strict=False):
            if before is not None:
                way += float(np.linalg.norm(positions[row] - positions[before]))
                turned += abs((yaw[row] - yaw[before] + math.pi) % (2 * math.pi) - math.pi)
            if way >= spacing or turned >= math.radians(turn_deg):
                kept.append(row)
                way, turned = 0.0, 0.0
    return kept
