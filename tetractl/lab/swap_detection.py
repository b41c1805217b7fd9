"""Detects swapped or wrong robot numbers: a robot that does not turn as it is commanded, but as
another robot is commanded.

For robot i, the measured turning rate s_i(t) [rad/s] is compared with the rate w_j commanded to
each robot j, with a delay d and a gain g,

    Q_ij = min over d, g of the integral of g^2 w_j(t - d)^2 - 2 g s_i(t) w_j(t - d) dt,

which is the integral of (s_i - g w_j)^2 without the term s_i^2, which is the same for all j. The
gain g is 1 for another robot's commands. For a robot's own commands, g is fitted, since
uncalibrated wheels turn the robot somewhat more or less, and so is a constant rate b at which
unequal wheels turn it: its own commands are g w_i + b. Robot i follows j if Q_ii - Q_ij exceeds a
fraction of the integral of (w_i - w_j)^2, and w_j explains some of how it turns.

A robot that moves as commanded follows no other robot, and robots that stand still cannot follow
one another in a ring (i follows j, j follows i): robots that follow one another in a ring are
swapped. A single robot that follows another may have a different fault, and is observed for longer.
Robots with the same commands cannot be distinguished.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.poses import Floats
from tetractl.lab.command_history import CommandHistory

DELAYS_NS = tuple(round(delay * SECOND) for delay in (0.0, 0.04, 0.08, 0.12, 0.16, 0.2, 0.3))
GAP_NS = 3 * SECOND // 20
GAINS = (0.8, 1.25)  # least and greatest gain of a robot's own commands
BIASES = (-0.5, -0.25, 0.0, 0.25, 0.5)  # rad/s: additional turning by wheels that are 10 % off
CLEAR = 0.01  # least Q_ii - Q_ij [rad^2/s], above the noise of headings
DISTINCT = 0.1  # least integral of (w_i - w_j)^2 for commands that can be distinguished
# least Q_ii - Q_ij in a ring, as a fraction of the integral of (w_i - w_j)^2
BETTER = 0.05
ALONE_NS = SECOND // 2  # time for which a single robot must follow another, twice in a row
ALONE_GAINS = (-1.25, 1.25)  # gains tried for its own commands, as a wheel may be stuck or inverted
ALONE_BETTER = 0.25  # the same for a single robot that follows another
ALONE_CLEAR = 0.06  # least Q_ii - Q_ij per integral of w_j^2, for a single robot
# the same for each robot of a ring: commands that change faster than wheels follow explain nothing
RING_EXPLAINED = 0.3
EXPLAINED = 0.8  # fraction of another robot's commanded turning that must be measured


class SwapDetector:
    """Compares how N robots are commanded to turn with how they turn."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = tuple(names)
        self._sent = CommandHistory(len(self._names))
        self.restart()

    def restart(self) -> None:
        """Forget all turning; called when robots start from rest."""
        n = len(self._names)
        self._all, self._stretch = _TurnIntegrals(n), _TurnIntegrals(n)
        # whether robot i followed j in its last stretch
        self._followed = np.zeros((n, n), dtype=np.bool_)
        # whether robot i alone followed j in its last two stretches
        self._alone = np.zeros((n, n), dtype=np.bool_)
        # duration of the stretch while commanded to turn
        self._watched_ns = np.zeros(n, dtype=np.int64)
        self._found: str | None = None  # the fault's message; None before the search
        # turns of one frame that are still to be compared: robots and angles [rad]
        self._turns: dict[int, float] = {}
        self._span = 0, 0  # their time [ns], and the time in which they were made

    def sent(self, now_ns: int, turning: Sequence[float]) -> None:
        """Take the turning rates of a transmission [rad/s], 0 for robots that stand."""
        self._compare()
        self._sent.sent(now_ns, turning)

    def turned(self, i: int, now_ns: int, dt_ns: int, angle: float) -> None:
        """Take a measured turn of robot i by `angle` [rad] within the last `dt_ns`.

        It is compared with the mean command over that time. A gap longer than GAP_NS is ignored,
        because the commands within it may differ.
        """
        if not 0 < dt_ns <= GAP_NS:
            return
        if self._span != (now_ns, dt_ns):
            self._compare()
        self._found, self._span = None, (now_ns, dt_ns)
        self._turns[i] = angle

    def _compare(self) -> None:
        """Compare the turns of a frame with the commands."""
        if not self._turns:
            return
        (now_ns, dt_ns), n = self._span, len(self._names)
        robots, dt = np.array([*self._turns]), dt_ns / SECOND
        turned = np.array([*self._turns.values()])
        rows = slice(None) if [*self._turns] == [*range(n)] else robots  # the first is faster
        self._turns = {}
        commanded = np.array([self._sent.mean(now_ns - delay, dt_ns) for delay in DELAYS_NS])
        terms = (
            (commanded**2 * dt)[:, None],
            turned[:, None] * commanded[:, None],
            (commanded[0] - commanded[0, robots, None]) ** 2 * dt,
            commanded[:, robots] * dt,
        )
        for integrals in (self._all, self._stretch):
            integrals.add(rows, *terms, turned, dt)
        self._watched_ns[rows] += dt_ns if commanded[0].any() else 0
        for i in robots[self._watched_ns[robots] >= ALONE_NS]:
            followed = self._stretch.follows_alone(i)
            self._alone[i] = followed & self._followed[i]
            self._followed[i] = followed
            self._watched_ns[i] = 0
            self._stretch.forget(i)

    def fault(self) -> str:
        """Return a text about robots that follow the commands of other robots, "" if none does."""
        self._compare()
        if self._found is None:
            self._found = self._fault()
        return self._found

    def _fault(self) -> str:
        if ring := _ring(self._all.follows()):
            names = " and ".join(self._names[i] for i in ring)
            return (
                f"{names} turn as another robot is commanded: are their numbers or bodies swapped?"
            )
        for i, j in np.argwhere(self._alone) if self._alone.any() else ():
            one, other = self._names[i], self._names[j]
            return f"{one} turns as {other} is commanded, not as {one} is: is its number wrong?"
        return ""


class _TurnIntegrals:
    """The integrals in Q_ij (see the module) over a stretch of time, for N robots and D delays."""

    def __init__(self, n: int) -> None:
        # integrals of w_j(t - d)^2 while i was tracked
        self._commanded = np.zeros((len(DELAYS_NS), n, n))
        self._common = np.zeros((len(DELAYS_NS), n, n))  # integrals of s_i(t) w_j(t - d)
        self._differ = np.zeros((n, n))  # integrals of (w_i - w_j)^2
        self._way = np.zeros((len(DELAYS_NS), n))  # integrals of w_i(t - d)
        self._turned, self._seconds = np.zeros(n), np.zeros(n)  # integrals of s_i, and of 1

    def add(
        self,
        rows: Any,
        commanded: Floats,
        common: Floats,
        differ: Floats,
        way: Floats,
        turned: Floats,
        dt: float,
    ) -> None:
        """Add turns of robots `rows` by `turned` [rad] within `dt` [s], and the integrals over
        them."""
        self._commanded[:, rows] += commanded
        self._common[:, rows] += common
        self._differ[rows] += differ
        self._way[:, rows] += way
        self._turned[rows] += turned
        self._seconds[rows] += dt

    def forget(self, i: int) -> None:
        """Forget the turning of robot i."""
        self._commanded[:, i] = self._common[:, i] = 0.0
        self._differ[i] = self._way[:, i] = self._turned[i] = self._seconds[i] = 0.0

    def follows(self) -> np.ndarray:
        """Return whether robot i follows the commands of robot j better than its own, (N, N)."""
        misfit = (self._commanded - 2.0 * self._common).min(axis=0)
        least = BETTER * self._differ + CLEAR
        if not (np.diagonal(misfit)[:, None] - misfit > 0.99 * least).any():
            return np.zeros(misfit.shape, dtype=np.bool_)  # with the best gain still less
        better = self._own(GAINS)[:, None] - misfit
        explained = misfit < -RING_EXPLAINED * self._commanded.max(axis=0)
        return (self._differ > DISTINCT) & (better > least) & explained

    def follows_alone(self, i: int) -> np.ndarray:
        """Return, for each robot (N,), whether robot i follows that robot's commands in a way that
        a bad wheel does not explain.
        """
        misfits = self._commanded[:, i] - 2.0 * self._common[:, i]
        misfit = misfits.min(axis=0)
        commanded = self._commanded[misfits.argmin(axis=0), i, np.arange(misfits.shape[1])]
        better = self._own(ALONE_GAINS)[i] - misfit
        return (
            (self._differ[i] > DISTINCT)
            & (commanded > DISTINCT)
            & (better > ALONE_BETTER * self._differ[i])
            & (better > ALONE_CLEAR * commanded)
            & (misfit < -EXPLAINED * commanded)
        )

    def _own(self, gains: tuple[float, float]) -> Floats:
        """Return Q_ii (N,), for the best bias and the best gain between the two `gains`."""
        bias = np.array(BIASES)[:, None, None]
        commanded = np.diagonal(self._commanded, axis1=1, axis2=2)
        common = np.diagonal(self._common, axis1=1, axis2=2) - bias * self._way  # (B, D, N)
        gain = np.clip(common / np.maximum(commanded, 1e-12), *gains)
        misfit = gain**2 * commanded - 2.0 * gain * common
        return (misfit + bias**2 * self._seconds - 2.0 * bias * self._turned).min(axis=(0, 1))


def _ring(follows: np.ndarray) -> list[int]:
    """Return a ring of robots, each of which follows the next, and the last the first; [] if there
    is none.
    """
    if not follows.any():
        return []
    reach = follows.copy()
    for k in range(len(follows)):
        reach |= np.outer(reach[:, k], reach[k])
    for i in np.flatnonzero(np.diagonal(reach)):
        return [int(j) for j in np.flatnonzero(reach[i] & reach[:, i])]
    return []
