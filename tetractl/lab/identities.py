"""Whether robots turn as they are told, or as one another is: swapped or wrong robot numbers.

For robot i, the turning seen s_i(t) [rad/s] is held against the turning w_j sent to each robot j,
of a delay d and a gain g,

    Q_ij = min over d, g of the integral of g^2 w_j(t - d)^2 - 2 g s_i(t) w_j(t - d) dt,

which is the squared residual of j's commands less a term common to all j. The gain is 1 but for a
robot's own commands: wheels that are not calibrated turn it by some more or less. Robot i follows j
where Q_ii - Q_ij exceeds a share of the integral of (w_i - w_j)^2. A robot that does as told
follows nobody, and robots that stand still cannot follow one another in a ring: so robots of a ring
are swapped. One robot alone may have another fault, and is watched for longer. Robots that are told
the same cannot be told apart.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Sequence

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.poses import Floats

DELAYS_NS = tuple(round(delay * SECOND) for delay in (0.0, 0.04, 0.08, 0.12, 0.16, 0.2, 0.3))
KEPT_NS = SECOND  # of what was sent
GAP_NS = 3 * SECOND // 20
GAINS = (0.8, 1.25)  # of a robot's own commands, least and most
APART = 0.1  # rad^2/s: commands that differ less, over all, cannot be told apart
BETTER = 0.05  # share of that by which another robot's commands must fit each of a ring better
ALONE_NS = 3 * SECOND // 4  # a robot alone must be watched for this long
ALONE_GAINS = (-1.25, 1.25)  # its own commands are tried with: a wheel may be stuck, or inverted
ALONE_BETTER = 0.25  # share of that by which another's commands must fit it better,
EXPLAINED = 0.8  # and share of them that must be seen
TINY = 1e-12


class Identities:
    """Compares how N robots are told to turn with how they turn."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = tuple(names)
        self._times: list[int] = []  # of the turning rates sent, a row each
        self._sent: list[Floats] = []
        self._shared: tuple[tuple[int, int], Floats] | None = None  # the same for a frame's robots
        self.restart()

    def restart(self) -> None:
        """Forget what was seen, as when robots start from rest."""
        n, delays = len(self._names), len(DELAYS_NS)
        self._told = np.zeros((delays, n, n))  # integral of w_j(t - d)^2 while i was seen
        self._common = np.zeros((delays, n, n))  # integral of s_i(t) w_j(t - d)
        self._apart = np.zeros((n, n))  # integral of (w_i - w_j)^2
        self._watched_ns = np.zeros(n, dtype=np.int64)  # how long robot i was seen while told to

    def sent(self, now_ns: int, turning: Sequence[float]) -> None:
        """Note the turning rates of a transmission [rad/s], 0 for robots that stand."""
        self._shared = None
        self._times.append(now_ns)
        self._sent.append(np.array(turning, dtype=np.float64))
        old = bisect_right(self._times, now_ns - KEPT_NS)
        if old > 64:  # now and then, in one go
            del self._times[: old - 1], self._sent[: old - 1]

    def turned(self, i: int, now_ns: int, dt_ns: int, angle: float) -> None:
        """Note that robot i was seen to turn by `angle` [rad] within the last `dt_ns`.

        The turning told is the mean over that time. A robot that was not seen for longer than
        GAP_NS tells nothing: it may have done several things.
        """
        if dt_ns > GAP_NS:
            return
        dt, key = dt_ns / SECOND, (now_ns, dt_ns)
        if self._shared is None or self._shared[0] != key:
            told = np.array([self._mean(now_ns - delay, dt_ns) for delay in DELAYS_NS])
            self._shared = key, told
        told = self._shared[1]  # (D, N)
        self._told[:, i] += told**2 * dt
        self._common[:, i] += angle * told
        self._watched_ns[i] += dt_ns if told[0].any() else 0
        self._apart[i] += (told[0] - told[0, i]) ** 2 * dt

    def fault(self) -> str:
        """Return which robots answer the commands of others, "" where none does."""
        misfits = self._told - 2.0 * self._common
        misfit = misfits.min(axis=0)
        better = self._own(GAINS)[:, None] - misfit
        follows = (self._apart > APART) & (better > BETTER * self._apart)
        if not follows.any():
            return ""
        if ring := _ring(follows):
            names = " and ".join(self._names[i] for i in ring)
            return f"{names} turn as one another is told: are their numbers or bodies swapped?"
        told = np.take_along_axis(self._told, misfits.argmin(axis=0)[None], axis=0)[0]
        return self._alone(misfit, told)

    def _alone(self, misfit: Floats, told: Floats) -> str:
        """Return who follows another and cannot have lost a wheel, or swapped its own."""
        better = self._own(ALONE_GAINS)[:, None] - misfit
        sure = (
            (self._watched_ns > ALONE_NS)[:, None]
            & (self._apart > APART)
            & (told > APART)
            & (better > ALONE_BETTER * self._apart)
            & (misfit < -EXPLAINED * told)
        )
        for i, j in np.argwhere(sure):
            one, other = self._names[i], self._names[j]
            return f"{one} turns as {other} is told, not as {one} is: is its number wrong?"
        return ""

    def _own(self, gains: tuple[float, float]) -> Floats:
        """Return Q_ii (N,) of each robot's own commands, for the best gain between two."""
        told = np.diagonal(self._told, axis1=1, axis2=2)
        common = np.diagonal(self._common, axis1=1, axis2=2)
        gain = np.clip(common / np.maximum(told, TINY), *gains)
        return (gain**2 * told - 2.0 * gain * common).min(axis=0)

    def _mean(self, until_ns: int, dt_ns: int) -> Floats:
        """Return the mean turning rates (N,) in force within the `dt_ns` until a time, 0 before
        the first transmission."""
        total, first = np.zeros(len(self._names)), until_ns - dt_ns
        while True:
            k = bisect_left(self._times, until_ns) - 1
            if k < 0:
                return total / dt_ns
            since = max(self._times[k], first)
            total = total + self._sent[k] * (until_ns - since)
            if since == first:
                return total / dt_ns
            until_ns = since


def _ring(follows: np.ndarray) -> list[int]:
    """Return robots each of whom follows the next and the last the first, [] where none do."""
    reach = follows.copy()
    for k in range(len(follows)):
        reach |= np.outer(reach[:, k], reach[k])
    for i in np.flatnonzero(np.diagonal(reach)):
        return [int(j) for j in np.flatnonzero(reach[i] & reach[:, i])]
    return []
