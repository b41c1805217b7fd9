"""The filter of one robot with whole matrices, to be read: what `control.kernels.filter` computes.

Its constants are those of the kernel.
"""

import math
from dataclasses import dataclass

import numpy as np

from tetractl.control.kernels import filter_state as kernel
from tetractl.control.kernels.filter_motion import AT_REST, UNKNOWN_HEADING
from tetractl.control.kernels.filter_state import (
    ASSUMED,
    FLOW_X,
    FLOW_Y,
    HEADING,
    HELIX_COSINE,
    HELIX_SINE,
    LN_A,
    LN_FREQUENCY,
    LN_SATURATION,
    LN_SPEED,
    MARKER_BIAS,
    PACE,
    SIDE,
    STATES_OF_CELLS,
    SWING,
    TURN_BIAS,
    X,
    Y,
)
from tetractl.core.poses import Floats, wrap
from tetractl.model.motion.exact import EXACT
from tetractl.model.motion.turn_rate import by_turning, held, turning


@dataclass
class Hypothesis:
    """What a robot may be doing: a direction u it follows, NaN where it stands, and the time until
    its watchdog stops it."""

    u: float
    ln_weight: float
    z: Floats
    cov: Floats
    left: float = math.inf


class RobotFilter:
    """Robot i of a kernel's model with one dead time: hypotheses by slot, the stuck one last."""

    def __init__(
        self,
        model: kernel.FilterModel,
        i: int,
        z: Floats,
        cov: Floats,
        follows: int = kernel.FOLLOWS,
    ) -> None:
        (self.a, self.v), self.helix, self.lag = model.parameters[i], model.helix_rad_s, model.lag_s
        self.hold = model.hold
        self.watchdog, self.sticks = model.watchdog_s, model.sticks
        self.noise = model.noise[:, i]
        # robots on wheels are cells without a helix
        missing = STATES_OF_CELLS - len(cov)
        self.walk = np.pad(model.walk[:, i], (0, missing))
        cov = np.pad(cov, (0, missing))
        self.scale = np.ones(2)
        self.slots: list[Hypothesis | None] = [Hypothesis(math.nan, 0.0, z.copy(), cov.copy())]
        self.slots += [None] * follows

    def follow(self, seconds: float, pose: Floats) -> float:
        """Predict and update by a measured pose; return the ln of its likelihood."""
        for one in filter(None, self.slots):
            self.advance(one, seconds)
        found = self.weigh(pose)
        self.stick(seconds)
        return found

    def advance(self, one: Hypothesis, seconds: float) -> None:
        """Predict: z' = f(z), P' = F P F' + Q.

        The heading in which lagging wheels come to rest follows (3), and turning rate and speed
        approach its mean rate and that of the direction.
        """
        if one.left < seconds:
            driven, one.left = one.left, math.inf
            self.advance(one, driven)
            seconds, one.u = seconds - driven, math.nan
        one.left -= seconds
        stands = math.isnan(one.u)
        if stands and (self.lag == 0 or one.z[PACE] < ASSUMED.still):
            one.z[[SWING, PACE]] = 0.0
        longest = max(ASSUMED.substep_s, seconds / ASSUMED.substeps)
        while seconds > 0 and (not stands or one.z[PACE] > 0):
            t, z = min(seconds, longest), one.z
            seconds -= t
            a, v = self.a * math.exp(z[LN_A]), self.v * math.exp(z[LN_SPEED])
            rest, towards = z[HEADING] + self.lag * a * z[SWING], one.u + z[TURN_BIAS]
            cos_sin = math.cos(rest), math.sin(rest), math.cos(towards), math.sin(towards)
            rate, slopes = turning(*cos_sin, (a, v, z[SIDE], self.saturation(z)), t)
            if self.hold[0]:
                cosine = math.cos(towards - rest)
                rate, slopes = held(rate, slopes, cosine, math.sin(towards - rest), self.hold)
            step = EXACT.lanes.differentiate(*cos_sin, (rate, v), t)
            step = AT_REST if stands else by_turning(step, slopes)
            (*way, turn), (*by_heading, keep), (*by_bias, _), ((*by_a, turn_a), *_) = step
            swing, pace = z[SWING], z[PACE]
            if self.lag:
                wish, goal = turn / (a * t), 0.0 if stands else 1.0
                half = turn / 2 + a * (self.integral(wish, swing, t / 2) - t / 2 * wish)
                turn = turn_a = a * self.integral(wish, swing, t)
                length = v * self.integral(goal, pace, t) * np.sinc(turn / math.tau)
                middle = z[HEADING] + half
                way = length * np.array([math.cos(middle), math.sin(middle)])
                left = np.array([-way[1], way[0]])  # by the heading in the middle
                by_heading, by_bias = left * (1 + keep) / 2, left * (1 - keep) / 2
                by_a = left * half
                swing, pace = self.lagged(wish, swing, t), self.lagged(goal, pace, t)
            jacobian, where = np.eye(STATES_OF_CELLS), [X, Y]
            jacobian[where, HEADING], jacobian[where, TURN_BIAS] = by_heading, by_bias
            jacobian[where, LN_A], jacobian[where, LN_SPEED] = by_a, way
            jacobian[X, FLOW_X] = jacobian[Y, FLOW_Y] = t
            jacobian[HEADING, [HEADING, LN_A, TURN_BIAS]] = keep, turn_a, 1 - keep
            if not stands:
                a_by, (_, *by_turns) = [X, Y, HEADING], slopes
                jacobian[np.ix_(a_by, [SIDE, LN_SATURATION])] = np.outer(
                    jacobian[a_by, LN_A], by_turns
                )
            angle = self.helix * math.exp(z[LN_FREQUENCY]) * t
            turned = np.array(
                [[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]]
            )
            helix = turned @ z[[HELIX_SINE, HELIX_COSINE]]
            jacobian[np.ix_([HELIX_SINE, HELIX_COSINE], [HELIX_SINE, HELIX_COSINE])] = turned
            jacobian[HELIX_SINE, LN_FREQUENCY], jacobian[HELIX_COSINE, LN_FREQUENCY] = (
                angle * helix[1],
                -angle * helix[0],
            )
            moved = z.copy()
            moved[[X, Y]] += np.array(way) + t * z[[FLOW_X, FLOW_Y]]
            moved[HEADING] += turn
            moved[SWING], moved[PACE] = swing, pace
            moved[[HELIX_SINE, HELIX_COSINE]] = helix
            walk = self.walk**2 * t
            walk[[X, Y, HEADING]] *= self.scale[[0, 0, 1]]
            one.z, one.cov = moved, jacobian @ one.cov @ jacobian.T + np.diag(walk)
            if one.cov[HEADING, HEADING] > UNKNOWN_HEADING:
                shares = np.ones(STATES_OF_CELLS)
                shares[HEADING] = math.sqrt(UNKNOWN_HEADING / one.cov[HEADING, HEADING])
                one.cov *= np.outer(shares, shares)

    def saturation(self, z: Floats) -> float:
        """Return the saturation of wheels; cells do not saturate."""
        return 1.0 if self.helix else math.exp(min(z[LN_SATURATION], 0.0))

    def lagged(self, wish: float, value: float, t: float) -> float:
        """Return a value that approaches `wish` for a time t."""
        return wish + (value - wish) * math.exp(-t / self.lag) if self.lag else wish

    def integral(self, wish: float, value: float, t: float) -> float:
        """Return the integral over a time t of a value that approaches `wish`."""
        return t * wish + self.lag * (value - self.lagged(wish, value, t))

    def rows(self, z: Floats) -> tuple[Floats, Floats]:
        """Return what a camera would measure (3,), and its slopes by the state (3, n)."""
        c, s = math.cos(z[HEADING]), math.sin(z[HEADING])
        rate = self.helix * math.exp(z[LN_FREQUENCY]) / (self.v * math.exp(z[LN_SPEED]))
        across, h = rate * z[HELIX_COSINE], np.zeros((3, STATES_OF_CELLS))
        h[0, X] = h[1, Y] = h[2, HEADING] = h[2, MARKER_BIAS] = 1.0
        h[0, HELIX_SINE], h[1, HELIX_SINE] = -s, c
        h[0, HEADING], h[1, HEADING] = -c * z[HELIX_SINE], -s * z[HELIX_SINE]
        h[2, [HELIX_COSINE, LN_FREQUENCY, LN_SPEED]] = np.array([rate, across, -across]) / (
            1 + across**2
        )
        tilted = z[HEADING] + z[MARKER_BIAS] + math.atan(across)
        return np.array([z[X] - s * z[HELIX_SINE], z[Y] + c * z[HELIX_SINE], tilted]), h

    def measure(self, one: Hypothesis, pose: Floats) -> tuple[float, Floats]:
        """Update by x, y and heading in turn; return ln of the likelihood, and mean squares."""
        expected, h = self.rows(one.z)
        var = self.noise**2 * self.scale[[0, 0, 1]]
        off = pose - expected
        off[2] = wrap(off[2])
        sure = np.diag(h @ one.cov @ h.T) + var
        squares = off**2 / sure
        means = np.array([squares[:2].mean(), squares[2]])
        if squares.sum() > ASSUMED.gate:
            return -(ASSUMED.gate + np.log(sure).sum()) / 2, means
        total, before = 0.0, one.z[:STATES_OF_CELLS].copy()
        for j in range(3):  # each number with the slopes of before the first
            miss = off[j] - h[j] @ (one.z[:STATES_OF_CELLS] - before)
            s = h[j] @ one.cov @ h[j] + var[j]
            gain = one.cov @ h[j] / s
            one.z[:STATES_OF_CELLS] += gain * miss
            one.cov = one.cov - np.outer(gain, gain) * s
            total -= (miss**2 / s + math.log(s)) / 2
        return float(total), means

    def weigh(self, pose: Floats) -> float:
        """Update all hypotheses and their weights, and the noise by what the likely one missed."""
        known, means = [], {}
        for i, one in enumerate(self.slots):
            if one is not None:
                ln, means[i] = self.measure(one, pose)
                one.ln_weight += ln
                known.append(i)
        weights = np.array([self.slots[i].ln_weight for i in known])
        best = known[int(np.argmax(weights))]
        total = float(weights.max() + math.log(np.exp(weights - weights.max()).sum()))
        for i in known:
            one = self.slots[i]
            one.ln_weight = max(one.ln_weight - total, ASSUMED.least_ln_weight)
        if 2 * means[best][0] + means[best][1] <= ASSUMED.gate:
            capped = np.minimum(means[best], 4.0) / ASSUMED.mean_capped
            scale = self.scale * (1 + (capped - 1) / ASSUMED.scale_memory)
            self.scale = np.clip(scale, ASSUMED.scale_least, ASSUMED.scale_most)
        return total

    def best(self) -> int:
        """Return the likely slot of the directions followed."""
        weights = [-math.inf if s is None else s.ln_weight for s in self.slots[:-1]]
        return int(np.argmax(weights))

    def copy(self, source: int, u: float, ln_weight: float) -> Hypothesis:
        """Return a hypothesis in the state of another."""
        one = self.slots[source]
        assert one is not None
        return Hypothesis(u, ln_weight, one.z.copy(), one.cov.copy(), one.left)

    def switch(self, u: float, step: float) -> None:
        """Let a command act that no hypothesis follows yet: it was heard, or not."""
        best = self.best()
        before = self.slots[best]
        new = self.copy(best, u, before.ln_weight + math.log(1 - ASSUMED.lost))
        new.left = self.watchdog
        lns = [-math.inf if s is None else s.ln_weight for s in self.slots[:-1]]
        place = int(np.argmin(lns))
        for one in filter(None, self.slots[:-1]):
            one.ln_weight += math.log(ASSUMED.lost)
        self.blur(new, before.u, u, step)
        self.slots[place] = new

    def blur(self, new: Hypothesis, before: float, u: float, step: float) -> None:
        """Add the uncertainty of a pose because the time at which u acts is uncertain by `step`."""

        def rate(direction: float) -> float:
            if math.isnan(direction):
                return 0.0
            a, at, to = self.a * math.exp(new.z[LN_A]), new.z[HEADING], direction + new.z[TURN_BIAS]
            own = a, self.v, new.z[SIDE], self.saturation(new.z)
            cos_sin = math.cos(at), math.sin(at), math.cos(to), math.sin(to)
            return turning(*cos_sin, own, 0.0)[0] * math.sin(to - at)

        new.cov[HEADING, HEADING] += (step * (rate(u) - rate(before))) ** 2 / 12
        if math.isnan(before) != math.isnan(u):
            far = step * self.v * math.exp(new.z[LN_SPEED])
            new.cov[[X, Y], [X, Y]] += far**2 / 12

    def branch(self, u: float, step: float) -> None:
        """Let a command act that each hypothesis heard, or not; keep the likeliest of both."""
        told: list[tuple[float, Hypothesis, bool]] = []
        for one in filter(None, self.slots[:-1]):
            same = one.u == u
            told.append((one.ln_weight + (0 if same else math.log(1 - ASSUMED.lost)), one, True))
            if not same:
                told.append((one.ln_weight + math.log(ASSUMED.lost), one, False))
        kept: list[tuple[Hypothesis, Hypothesis]] = []
        for ln, one, heard in sorted(told, key=lambda each: -each[0]):
            way = u if heard else one.u
            least = ASSUMED.alike * one.cov[HEADING, HEADING]
            for source, twin in kept:
                if twin.u == way and (source.z[HEADING] - one.z[HEADING]) ** 2 < least:
                    twin.ln_weight = float(np.logaddexp(twin.ln_weight, ln))
                    break
            else:
                new = Hypothesis(way, ln, one.z.copy(), one.cov.copy(), one.left)
                if heard:
                    self.blur(new, one.u, u, step)
                    new.left = self.watchdog
                kept.append((one, new))
        room = len(self.slots) - 1
        kept = kept[:room]
        self.slots[:-1] = [new for _, new in kept] + [None] * (room - len(kept))

    def stick(self, seconds: float) -> None:
        """Let the robot get stuck, or come free."""
        best = self.best()
        moving, stuck = self.slots[best], self.slots[-1]
        if math.isnan(moving.u):
            self.slots[-1] = None
            return
        if stuck is not None:
            strays, turns = self.sticks.strays, self.sticks.turns
            grown = np.array([strays, strays, turns]) ** 2 * seconds
            stuck.cov[[X, Y, HEADING], [X, Y, HEADING]] += grown
        share = min(0.5, seconds / self.sticks.for_s)
        weight = -math.inf if stuck is None else stuck.ln_weight
        sticks = moving.ln_weight + math.log(min(0.5, seconds / self.sticks.every_s))
        if weight + math.log(share) > moving.ln_weight:
            free = self.copy(-1, moving.u, weight + math.log(share))
            free.left = moving.left
            self.slots[best] = free
        elif sticks > weight + math.log(1 - share):
            self.slots[-1] = self.copy(best, math.nan, sticks)
            return
        if stuck is not None:
            stuck.ln_weight = weight + math.log(1 - share)
