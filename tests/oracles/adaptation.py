"""What a robot learns of g_psi while it drives, written out: a list of ratios for each context and action."""

import math

import numpy as np


class Adapter:
    """Takes part in `tests.oracles.control.follow`; numbers are a dict of weight, keep, every and expected [C][A]."""

    def __init__(self, kind, numbers, actions, costs):
        self.kind, self.numbers, self.actions, self.costs = kind, numbers, actions, costs
        self.ratios, self.last, self.trials, self.asked = {}, {}, {}, 0

    def factor(self, context, action):
        """What the prior is multiplied by: the oldest ratio has the most powers of lambda, the prior one more."""
        ratios, keep = self.ratios.get((context, action), []), self.numbers["keep"]
        weights = [self.numbers["weight"] * keep ** len(ratios)]
        weights += [keep ** (len(ratios) - 1 - i) for i in range(len(ratios))]
        mean = sum(w * r for w, r in zip(weights, [1.0, *ratios], strict=True)) / sum(weights)
        return math.sqrt(max(mean, 0.0025)) if self.kind == "innovation" else mean

    def predicted(self, context, prior):
        """Predictions of all actions in a context."""
        return [prior[a] * self.factor(context, a) for a in range(len(self.actions))]

    def choose(self, t, context, usual, seen):
        """The action that is sent instead of the usual one, and what must be remembered."""
        sizes = [size for _, _, size in self.actions]
        cheaper = [a for a in range(len(sizes)) if seen["allowed"][a] and sizes[a] < sizes[usual]]
        every, action, probe = self.numbers["every"], usual, False
        on_trial = self.trials.get(context, (None, []))[0]
        if every > 0 and on_trial in cheaper:
            action, probe = on_trial, True
        elif every > 0 and (self.asked + 1) % every == 0 and cheaper:
            action, probe = min(cheaper, key=lambda a: (self.last.get((context, a), -1), sizes[a])), True
        self.asked += 1
        self.last[context, action] = t
        cost = [self.costs(a, seen["rate"], seen["delay"][a]) for a in (usual, action)]
        goal = seen["predicted"][usual] + cost[0] - cost[1]
        return action, (context, action, seen["risk"], goal, probe)

    def hear(self, asked, risk, innovation):
        """An answer: the risk that it claims, and the vector from the estimate to its position."""
        context, action, local, goal, probe = asked
        expected = max(self.numbers["expected"][context][action], 1e-3)
        if self.kind == "innovation":
            ratio = (float(innovation @ innovation) - local**2) / expected**2
        else:
            ratio = risk / expected
        self.ratios.setdefault((context, action), []).append(ratio)
        if probe:
            before, risks = self.trials.get(context, (None, []))
            risks = [*(risks if before == action else []), risk]
            self.trials[context] = (action if np.mean(risks) <= goal else None, risks)
