"""The filter of one robot with whole matrices, to be read: what `control.kernels.filter` computes.

Its constants are those of the kernel.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from tetractl.control.kernels import filter_state as kernel
from tetractl.control.kernels.filter import (
    ALIKE,
    LEAST_LN_WEIGHT,
    MEAN_CAPPED,
    SCALE_LEAST,
    SCALE_MEMORY,
    SCALE_MOST,
)
from tetractl.control.kernels.filter_motion import (
    AT_REST,
    STILL_PACE,
    SUBSTEP_S,
    SUBSTEPS_MAX,
    UNKNOWN_HEADING,
)
from tetractl.control.kernels.filter_state import (
    FLOW_X,
    FLOW_Y,
    GATE,
    HEADING,
    HELIX_COSINE,
    HELIX_SINE,
    LN_A,
    LN_FREQUENCY,
    LN_SATURATION,
    LN_SPEED,
    LOSS_PROBABILITY,
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

LN_HEARD = math.log(1 - LOSS_PROBABILITY)
LN_LOST = math.log(LOSS_PROBABILITY)


@dataclass
class Hypothesis:
    """What a robot may be doing: a direction u it follows, NaN where it stands; its state z with
    the covariance; and how long its watchdog lets it go on [s]."""

    u: float
    ln_weight: float
    z: Floats
    cov: Floats
    watched_s: float = math.inf


@dataclass(frozen=True)
class Motion:
    """How a short step moves a robot, and the slopes of its way and of its turn."""

    way: Floats  # of x and y (2,)
    turn: float
    swing: float  # after the step
    pace: float  # after the step
    way_by_heading: Floats
    way_by_bias: Floats
    way_by_ln_a: Floats
    heading_by_heading: float  # the share of a change of the heading that stays
    turn_by_ln_a: float
    ln_a_by_turning: Floats  # of the a of the step, by side and ln saturation (2,)


@dataclass(frozen=True)
class Branch:
    """A hypothesis that hears a command, or does not, and the weight of that."""

    parent: Hypothesis
    ln_weight: float
    hears: bool


def cos_sin_of(heading: float, towards: float) -> tuple[float, float, float, float]:
    """Return cosine and sine of two angles."""
    of_heading = math.cos(heading), math.sin(heading)
    return (*of_heading, math.cos(towards), math.sin(towards))


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
        self.a, self.v = model.parameters[i]
        self.helix = model.helix_rad_s
        self.lag = model.lag_s
        self.hold = model.hold
        self.watchdog = model.watchdog_s
        self.sticks = model.sticks
        self.noise = model.noise[:, i]
        # robots on wheels are cells without a helix
        missing = STATES_OF_CELLS - len(cov)
        self.walk = np.pad(model.walk[:, i], (0, missing))
        cov = np.pad(cov, (0, missing))
        self.scale = np.ones(2)
        self.slots: list[Hypothesis | None] = [Hypothesis(math.nan, 0.0, z.copy(), cov.copy())]
        self.slots += [None] * follows

    def advance(self, hypothesis: Hypothesis, seconds: float) -> None:
        """Predict by short steps, to the watchdog's stop and on from there."""
        if hypothesis.watched_s < seconds:
            driven_s = hypothesis.watched_s
            hypothesis.watched_s = math.inf
            self.advance(hypothesis, driven_s)
            hypothesis.u = math.nan
            seconds -= driven_s
        hypothesis.watched_s -= seconds
        stands = math.isnan(hypothesis.u)
        if stands and (self.lag == 0 or hypothesis.z[PACE] < STILL_PACE):
            hypothesis.z[[SWING, PACE]] = 0.0
        longest = max(SUBSTEP_S, seconds / SUBSTEPS_MAX)
        while seconds > 0 and (not stands or hypothesis.z[PACE] > 0):
            t = min(seconds, longest)
            self.predict(hypothesis, t)
            seconds -= t

    def predict(self, hypothesis: Hypothesis, t: float) -> None:
        """Predict by one short step: z' = f(z), P' = F P F' + Q."""
        z = hypothesis.z
        motion = self.motion(hypothesis, t)
        turned = self.helix_turned(z, t)
        moved = z.copy()
        moved[[X, Y]] += motion.way + t * z[[FLOW_X, FLOW_Y]]
        moved[HEADING] += motion.turn
        moved[SWING] = motion.swing
        moved[PACE] = motion.pace
        moved[[HELIX_SINE, HELIX_COSINE]] = turned @ z[[HELIX_SINE, HELIX_COSINE]]
        jacobian = self.slopes(z, motion, turned, t)
        walk = self.walk**2 * t
        walk[[X, Y, HEADING]] *= self.scale[[0, 0, 1]]
        hypothesis.z = moved
        hypothesis.cov = jacobian @ hypothesis.cov @ jacobian.T + np.diag(walk)
        heading_variance = hypothesis.cov[HEADING, HEADING]
        if heading_variance > UNKNOWN_HEADING:
            shares = np.ones(STATES_OF_CELLS)
            shares[HEADING] = math.sqrt(UNKNOWN_HEADING / heading_variance)
            hypothesis.cov *= np.outer(shares, shares)

    def motion(self, hypothesis: Hypothesis, t: float) -> Motion:
        """Return how a robot moves in a step of t.

        The heading in which lagging wheels come to rest follows (3), and turning rate and speed
        approach its mean rate and that of the direction.
        """
        z = hypothesis.z
        a = self.a * math.exp(z[LN_A])
        v = self.v * math.exp(z[LN_SPEED])
        stands = math.isnan(hypothesis.u)
        rest = z[HEADING] + self.lag * a * z[SWING]
        towards = hypothesis.u + z[TURN_BIAS]
        cos_sin = cos_sin_of(rest, towards)
        rate, slopes = turning(*cos_sin, (a, v, z[SIDE], self.saturation(z)), t)
        if self.hold[0]:
            phi = towards - rest
            rate, slopes = held(rate, slopes, math.cos(phi), math.sin(phi), self.hold)
        step = EXACT.lanes.differentiate(*cos_sin, (rate, v), t)
        step = AT_REST if stands else by_turning(step, slopes)
        (*way, turn), (*by_heading, heading_by_heading), (*by_bias, _), by_parameters = step
        *by_ln_a, turn_by_ln_a = by_parameters[0]
        motion = Motion(
            way=np.array(way),
            turn=turn,
            swing=z[SWING],
            pace=z[PACE],
            way_by_heading=np.array(by_heading),
            way_by_bias=np.array(by_bias),
            way_by_ln_a=np.array(by_ln_a),
            heading_by_heading=heading_by_heading,
            turn_by_ln_a=turn_by_ln_a,
            ln_a_by_turning=np.zeros(2) if stands else np.array(slopes[1:]),
        )
        if not self.lag:
            return motion
        goal = 0.0 if stands else 1.0
        return self.lagging(motion, z, a, v, goal, t)

    def lagging(
        self, motion: Motion, z: Floats, a: float, v: float, goal: float, t: float
    ) -> Motion:
        """Return the motion of wheels that lag, given that of the heading in which they come to
        rest; the pace approaches `goal`."""
        wish = motion.turn / (a * t)
        half = motion.turn / 2 + a * (self.integral(wish, z[SWING], t / 2) - t / 2 * wish)
        turn = a * self.integral(wish, z[SWING], t)
        length = v * self.integral(goal, z[PACE], t) * np.sinc(turn / math.tau)
        middle = z[HEADING] + half
        way = length * np.array([math.cos(middle), math.sin(middle)])
        leftwards = np.array([-way[1], way[0]])  # by the heading in the middle
        stays = motion.heading_by_heading
        return replace(
            motion,
            way=way,
            turn=turn,
            swing=self.lagged(wish, z[SWING], t),
            pace=self.lagged(goal, z[PACE], t),
            way_by_heading=leftwards * (1 + stays) / 2,
            way_by_bias=leftwards * (1 - stays) / 2,
            way_by_ln_a=leftwards * half,
            turn_by_ln_a=turn,
        )

    def helix_turned(self, z: Floats, t: float) -> Floats:
        """Return the rotation (2, 2) of the place on the helix, as sine and cosine."""
        angle = self.helix * math.exp(z[LN_FREQUENCY]) * t
        cosine = math.cos(angle)
        sine = math.sin(angle)
        return np.array([[cosine, sine], [-sine, cosine]])

    def slopes(self, z: Floats, motion: Motion, turned: Floats, t: float) -> Floats:
        """Return F, the slopes of the state after a step by the state before it (n, n)."""
        jacobian = np.eye(STATES_OF_CELLS)
        place = [X, Y]
        jacobian[place, HEADING] = motion.way_by_heading
        jacobian[place, TURN_BIAS] = motion.way_by_bias
        jacobian[place, LN_A] = motion.way_by_ln_a
        jacobian[place, LN_SPEED] = motion.way
        jacobian[X, FLOW_X] = t
        jacobian[Y, FLOW_Y] = t
        stays = motion.heading_by_heading
        jacobian[HEADING, [HEADING, LN_A, TURN_BIAS]] = stays, motion.turn_by_ln_a, 1 - stays
        for state, by_ln_a in zip([SIDE, LN_SATURATION], motion.ln_a_by_turning, strict=True):
            jacobian[[X, Y, HEADING], state] = jacobian[[X, Y, HEADING], LN_A] * by_ln_a
        helix = [HELIX_SINE, HELIX_COSINE]
        jacobian[np.ix_(helix, helix)] = turned
        angle = self.helix * math.exp(z[LN_FREQUENCY]) * t
        sine, cosine = turned @ z[helix]
        jacobian[HELIX_SINE, LN_FREQUENCY] = angle * cosine
        jacobian[HELIX_COSINE, LN_FREQUENCY] = -angle * sine
        return jacobian

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
        c = math.cos(z[HEADING])
        s = math.sin(z[HEADING])
        rate = self.helix * math.exp(z[LN_FREQUENCY]) / (self.v * math.exp(z[LN_SPEED]))
        across = rate * z[HELIX_COSINE]
        tilt = np.array([rate, across, -across]) / (1 + across**2)
        h = np.zeros((3, STATES_OF_CELLS))
        h[0, [X, HELIX_SINE, HEADING]] = 1.0, -s, -c * z[HELIX_SINE]
        h[1, [Y, HELIX_SINE, HEADING]] = 1.0, c, -s * z[HELIX_SINE]
        h[2, [HEADING, MARKER_BIAS]] = 1.0
        h[2, [HELIX_COSINE, LN_FREQUENCY, LN_SPEED]] = tilt
        tilted = z[HEADING] + z[MARKER_BIAS] + math.atan(across)
        return np.array([z[X] - s * z[HELIX_SINE], z[Y] + c * z[HELIX_SINE], tilted]), h

    def measure(self, hypothesis: Hypothesis, pose: Floats) -> tuple[float, Floats]:
        """Update by x, y and heading in turn; return ln of the likelihood, and mean squares."""
        expected, h = self.rows(hypothesis.z)
        var = self.noise**2 * self.scale[[0, 0, 1]]
        off = pose - expected
        off[2] = wrap(off[2])
        innovation_var = np.diag(h @ hypothesis.cov @ h.T) + var
        squares = off**2 / innovation_var
        means = np.array([squares[:2].mean(), squares[2]])
        if squares.sum() > GATE:
            return -(GATE + np.log(innovation_var).sum()) / 2, means
        ln_likelihood = 0.0
        before = hypothesis.z[:STATES_OF_CELLS].copy()
        for j in range(3):  # each number with the slopes of before the first
            miss = off[j] - h[j] @ (hypothesis.z[:STATES_OF_CELLS] - before)
            s = h[j] @ hypothesis.cov @ h[j] + var[j]
            gain = hypothesis.cov @ h[j] / s
            hypothesis.z[:STATES_OF_CELLS] += gain * miss
            hypothesis.cov = hypothesis.cov - np.outer(gain, gain) * s
            ln_likelihood -= (miss**2 / s + math.log(s)) / 2
        return float(ln_likelihood), means

    def weigh(self, pose: Floats) -> float:
        """Update all hypotheses and their weights, and the noise by what the likely one missed;
        return the ln of the pose's likelihood."""
        hypotheses = [hypothesis for hypothesis in self.slots if hypothesis is not None]
        means = []
        for hypothesis in hypotheses:
            ln, mean_squares = self.measure(hypothesis, pose)
            hypothesis.ln_weight += ln
            means.append(mean_squares)
        weights = np.array([hypothesis.ln_weight for hypothesis in hypotheses])
        total = float(np.logaddexp.reduce(weights))
        for hypothesis in hypotheses:
            hypothesis.ln_weight = max(hypothesis.ln_weight - total, LEAST_LN_WEIGHT)
        of_likeliest = means[int(np.argmax(weights))]
        if 2 * of_likeliest[0] + of_likeliest[1] <= GATE:
            capped = np.minimum(of_likeliest, 4.0) / MEAN_CAPPED
            scale = self.scale * (1 + (capped - 1) / SCALE_MEMORY)
            self.scale = np.clip(scale, SCALE_LEAST, SCALE_MOST)
        return total

    def best(self) -> int:
        """Return the likely slot of the directions followed."""
        weights = [-math.inf if s is None else s.ln_weight for s in self.slots[:-1]]
        return int(np.argmax(weights))

    def copy(self, source: int, u: float, ln_weight: float) -> Hypothesis:
        """Return a hypothesis in the state of another."""
        hypothesis = self.slots[source]
        assert hypothesis is not None
        return self.twin(hypothesis, u, ln_weight)

    def twin(self, hypothesis: Hypothesis, u: float, ln_weight: float) -> Hypothesis:
        """Return a hypothesis in the state of another, which follows u."""
        return replace(
            hypothesis,
            u=u,
            ln_weight=ln_weight,
            z=hypothesis.z.copy(),
            cov=hypothesis.cov.copy(),
        )

    def following(self) -> list[Hypothesis]:
        """Return the hypotheses of directions, without the stuck one."""
        return [hypothesis for hypothesis in self.slots[:-1] if hypothesis is not None]

    def switch(self, u: float, step: float) -> None:
        """Let a command act that no hypothesis follows yet: it was heard, or not."""
        best = self.best()
        before = self.slots[best]
        new = self.copy(best, u, before.ln_weight + LN_HEARD)
        new.watched_s = self.watchdog
        lns = [-math.inf if s is None else s.ln_weight for s in self.slots[:-1]]
        place = int(np.argmin(lns))
        for hypothesis in self.following():
            hypothesis.ln_weight += LN_LOST
        self.blur(new, before.u, u, step)
        self.slots[place] = new

    def blur(self, new: Hypothesis, before: float, u: float, step: float) -> None:
        """Add the uncertainty of a pose because the time at which u acts is uncertain by `step`."""

        def rate(direction: float) -> float:
            if math.isnan(direction):
                return 0.0
            heading = new.z[HEADING]
            towards = direction + new.z[TURN_BIAS]
            a = self.a * math.exp(new.z[LN_A])
            parameters = a, self.v, new.z[SIDE], self.saturation(new.z)
            a_of_turning, _ = turning(*cos_sin_of(heading, towards), parameters, 0.0)
            return a_of_turning * math.sin(towards - heading)

        new.cov[HEADING, HEADING] += (step * (rate(u) - rate(before))) ** 2 / 12
        if math.isnan(before) != math.isnan(u):
            far = step * self.v * math.exp(new.z[LN_SPEED])
            new.cov[[X, Y], [X, Y]] += far**2 / 12

    def branch(self, u: float, step: float) -> None:
        """Let a command act that each hypothesis heard, or not; keep the likeliest of both."""
        branches: list[Branch] = []
        for hypothesis in self.following():
            if hypothesis.u == u:
                branches.append(Branch(hypothesis, hypothesis.ln_weight, hears=True))
            else:
                branches.append(Branch(hypothesis, hypothesis.ln_weight + LN_HEARD, hears=True))
                branches.append(Branch(hypothesis, hypothesis.ln_weight + LN_LOST, hears=False))
        branches.sort(key=lambda branch: -branch.ln_weight)

        parents: list[Hypothesis] = []
        children: list[Hypothesis] = []
        for branch in branches:
            parent = branch.parent
            direction = u if branch.hears else parent.u
            alike = ALIKE * parent.cov[HEADING, HEADING]
            for other_parent, child in zip(parents, children, strict=True):
                apart = (other_parent.z[HEADING] - parent.z[HEADING]) ** 2
                if child.u == direction and apart < alike:
                    child.ln_weight = float(np.logaddexp(child.ln_weight, branch.ln_weight))
                    break
            else:
                child = self.twin(parent, direction, branch.ln_weight)
                if branch.hears:
                    self.blur(child, parent.u, u, step)
                    child.watched_s = self.watchdog
                parents.append(parent)
                children.append(child)
        room = len(self.slots) - 1
        self.slots[:-1] = [*children, *[None] * room][:room]

    def stick(self, seconds: float) -> None:
        """Let the robot get stuck, or come free."""
        best = self.best()
        moving = self.slots[best]
        stuck = self.slots[-1]
        if math.isnan(moving.u):
            self.slots[-1] = None
            return
        if stuck is not None:
            strays = self.sticks.strays
            grown = np.array([strays, strays, self.sticks.turns]) ** 2 * seconds
            stuck.cov[[X, Y, HEADING], [X, Y, HEADING]] += grown
        share = min(0.5, seconds / self.sticks.for_s)
        weight = -math.inf if stuck is None else stuck.ln_weight
        sticks = moving.ln_weight + math.log(min(0.5, seconds / self.sticks.every_s))
        if weight + math.log(share) > moving.ln_weight:
            free = self.copy(-1, moving.u, weight + math.log(share))
            free.watched_s = moving.watched_s
            self.slots[best] = free
        elif sticks > weight + math.log(1 - share):
            self.slots[-1] = self.copy(best, math.nan, sticks)
            return
        if stuck is not None:
            stuck.ln_weight = weight + math.log(1 - share)
