"""The turns of N robots under the directions sent to them, and their prediction by a model.

A direction acts from `tau` after it was sent, and turns a robot of turning rate a and heading bias
beta by the closed form of the paper's equations (1)-(3). The model starts each interval at the
measured heading. A robot that lost a direction follows the previous direction; the probability of a
loss is inferred from the robot's turns.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tetractl.core.poses import Bools, Floats, wrap
from tetractl.model.motion.exact import step
from tetractl.replay.identification.chain import Chain, ChainNoise
from tetractl.replay.identification.tracks import Drives, substeps

NUDGE_S, NUDGE = 0.001, 1e-4  # steps of tau [s], and of ln a, beta and headings, for derivatives
SURE = 0.01  # probability below which a loss counts as impossible
FEW = 0.5  # number added to the lost commands when the loss rate is estimated
LARGE = 100.0  # cap of a squared deviation, so that outliers have little influence


@dataclass(frozen=True, slots=True)
class Turning:
    """The parameters: dead time `tau` [s], `ln_a` (N,), the logarithms of the turning rates
    [rad/s], and `beta` (N,), the heading biases [rad].
    """

    tau: float
    ln_a: Floats
    beta: Floats

    def vector(self) -> Floats:
        """Return tau, ln a and beta as one vector (1 + 2 N,)."""
        return np.concatenate([[self.tau], self.ln_a, self.beta])

    @classmethod
    def of(cls, vector: Floats) -> "Turning":
        """Return the parameters that a vector from `Turning.vector` holds."""
        count = (len(vector) - 1) // 2
        return cls(float(vector[0]), vector[1 : 1 + count], vector[1 + count :])


class Turns:
    """The turns in K intervals, measured and predicted. `lost` (C, N) is the probability that a
    robot lost a direction, initially 0.
    """

    def __init__(self, drives: Drives) -> None:
        self.drives = drives
        count = len(drives.directions.u)
        self.lost = np.zeros((count, drives.moved.shape[1]))
        self._own = np.broadcast_to(np.arange(count)[:, None], self.lost.shape)
        # numbers of the commands followed if uncertain ones arrived, and if they were lost
        self._followed = self._own, self._own

    def motion(self, p: Turning, ahead: float = 0.0) -> tuple[Floats, Floats, Floats]:
        """Return displacement x and y per unit of speed [s] and the turn [rad], each (K, N).

        If it is uncertain whether a direction arrived, the motions with and without it are
        averaged, weighted by their probabilities. `ahead` [rad] is added to the measured headings
        at the intervals' starts.
        """
        arrived, lost = self._followed
        found = self._under(p, arrived, ahead)
        if arrived is lost:
            return found
        share = self.lost[self._main(p)]
        other = self._under(p, lost, ahead)
        x, y, turn = (one + share * (two - one) for one, two in zip(found, other, strict=True))
        return x, y, turn

    def missed(self, p: Turning) -> Floats:
        """Return the measured minus the predicted turns (K, N) [rad]."""
        return wrap(self.drives.intervals.turned - self.motion(p)[2])

    def derivatives(self, p: Turning) -> Floats:
        """Return the derivatives (K, N, 3) of the predicted turns with respect to tau, ln a and
        beta.
        """
        low = max(0.0, p.tau - NUDGE_S)
        pairs = (
            (replace(p, tau=p.tau + NUDGE_S), replace(p, tau=low), p.tau + NUDGE_S - low),
            (replace(p, ln_a=p.ln_a + NUDGE), replace(p, ln_a=p.ln_a - NUDGE), 2 * NUDGE),
            (replace(p, beta=p.beta + NUDGE), replace(p, beta=p.beta - NUDGE), 2 * NUDGE),
        )
        turns = [(self.motion(more)[2] - self.motion(less)[2]) / by for more, less, by in pairs]
        return np.stack(turns, axis=-1)

    def chains(self, p: Turning, used: Bools) -> list[Chain]:
        """Return the `Chain` of each robot's turns; `used` (K, N) is False for intervals to leave
        out.
        """
        more, less = self.motion(p, NUDGE)[2], self.motion(p, -NUDGE)[2]
        slopes = 1 + (more - less) / (2 * NUDGE)
        seconds, after = self.drives.seconds, self.drives.after
        return [Chain(seconds, slopes[:, i], used[:, i], after) for i in range(used.shape[1])]

    def believe(self, p: Turning, chains: list[Chain], noises: list[ChainNoise]) -> None:
        """Estimate the probability `lost` of each command from the robot's turns.

        Bayes' rule combines the likelihoods of the turns under the command's direction and under
        the previous one with the fraction of commands lost, as estimated so far.
        """
        hard = np.where(self.lost > 0.5, np.vstack([self._own[:1], self._own[:-1]]), self._own)
        before = np.vstack([hard[:1], hard[:-1]])
        turned, main = self.drives.intervals.turned, self._main(p)
        first = np.diff(main, prepend=-1) != 0
        gains = np.zeros(self.lost.shape)
        # an interval may begin under the previous direction: test every second direction at once
        for odd in (0, 1):
            asked = self._own % 2 == odd
            residuals = [
                wrap(turned - self._under(p, np.where(asked, one, hard))[2])
                for one in (self._own, before)
            ]
            for i, (chain, noise) in enumerate(zip(chains, noises, strict=True)):
                usable = self.drives.intervals.usable[:, i]
                apart = Chain(chain.t, chain.slope, usable, chain.linked & ~first)
                columns = np.column_stack([r[:, i] for r in residuals])
                y = np.minimum(apart.whiten(apart.factor(noise), columns) ** 2, LARGE)
                np.add.at(gains[:, i], main, np.where(main % 2 == odd, y[:, 0] - y[:, 1], 0.0))
        share = (self.lost.sum(axis=0) + FEW) / (len(hard) + 2 * FEW)
        odds = np.log(share / (1 - share)) + gains / 2
        self.lost = 1 / (1 + np.exp(-np.clip(odds, -50, 50)))
        self.lost[0] = 0.0
        arrived = np.where(self.lost > 1 - SURE, before, self._own)
        lost = np.where(self.lost < SURE, self._own, before)
        self._followed = (arrived, arrived if (arrived == lost).all() else lost)

    def _main(self, p: Turning) -> NDArray[np.int64]:
        """Return the index of the direction that acts at the end of each interval, (K,)."""
        when = self.drives.directions.when
        acts = np.searchsorted(when + p.tau, self.drives.intervals.until, "left") - 1
        return np.clip(acts, 0, len(when) - 1)

    def _under(
        self, p: Turning, followed: NDArray[np.int64], ahead: float = 0.0
    ) -> tuple[Floats, Floats, Floats]:
        """Return the motion, as `motion` does, of robots that follow direction `followed[c]` (C, N)
        in place of each direction c.
        """
        start = self.drives.intervals.heading + ahead
        u = self.drives.directions.u[followed]
        x, y, heading = np.zeros_like(start), np.zeros_like(start), start
        a, one = np.exp(p.ln_a), np.ones(())
        when = self.drives.directions.when
        for number, seconds in substeps(self.drives.intervals, when, p.tau):
            x, y, heading = step(x, y, heading, u[number] + p.beta, a, one, seconds[:, None])
        return x, y, heading - start
