"""Finds what is at fault when a pose contradicts commands: one robot, the camera, the radio, or the
numbers of two robots.

What robots have done in the last WINDOW_NS differs from what they were commanded by z_j (3,), in
standard deviations. Of the explanations

    one robot i:  the others follow their commands,    sum of |z_j|^2 over j != i
    the camera:   its picture shifts, turns and grows, least sum of |z_j - G_j g|^2 + |g|^2
    the radio:    all follow their commands later,     sum of |z_j|^2 with delayed commands

one of the last two must be better than the first by CLEAR. G_j g is the motion of pose j if the
picture moves at g, over LIKELY rates. For the camera, motion is compared as in `drift_check`; for
the radio, commands are integrated with each delay up to LATEST_NS, and the first explanation may
have any delay up to DELAY_NS.

Robots i and j have exchanged numbers or bodies if each moves as the other is commanded: then
|z_i|^2 + |z_j|^2 with the commands exchanged is below CLEAR, and with their own greater by CLEAR.
Each motion may have any delay up to DELAY_NS. That i alone moves as j is commanded is not asked: a
push of some millimetres is as well explained by it. Lengths are mm.
"""

from collections import deque
from collections.abc import Sequence

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.poses import Floats, Pose
from tetractl.lab.drift_check import BLOCK_NS, DriftCheck
from tetractl.lab.motion_check import AS_NO_COMMAND, DELAY_NS

WINDOW_NS = SECOND // 2
STEP_NS = SECOND // 40  # of the integration and between delays
LATEST_NS = SECOND  # the longest delay of a slow radio
LIKELY = np.array([100.0, 100.0, 0.1, 0.1])  # [mm/s, mm/s, rad/s, 1/s]
NOISE = np.array([2.0, 2.0, 0.02])  # of a difference: along and across the heading, and around
SHARE = np.array([0.08, 0.04, 0.1])  # of the way, or the angle, by which it may be wrong besides
CLEAR = 9.0
STANDS_NS, STANDS_MM = SECOND // 10, 3.0  # robots that move less in that time stand
CAMERA = "all robots are seen to move as no command does: has the camera or its origin moved?"
RADIO = "all robots move as they were commanded {:.1f} s before: is the radio slow?"
SWAPPED = "{} and {} move as the other is commanded: are their numbers or bodies swapped?"


class Culprit:
    """Keeps what the camera shows of N robots `names`, whose motion `drift` follows; `mm` is the
    number of millimetres per length unit.
    """

    def __init__(self, names: Sequence[str], drift: DriftCheck, mm: float) -> None:
        self._names, self._drift, self._mm = names, drift, mm
        self._seen: deque[tuple[int, Sequence[Pose | None], Sequence[int]]] = deque()
        self.suspect: int | None = None  # the robot that a run was aborted for

    def see(self, now_ns: int, poses: Sequence[Pose | None], times: Sequence[int]) -> None:
        """Take a frame's poses, accepted or not, and their times (N,) [ns]."""
        self._seen.append((now_ns, poses, times))
        while now_ns - self._seen[0][0] > WINDOW_NS:
            self._seen.popleft()

    def why(self, reason: str) -> str:
        """Return, once, a text if the camera, the radio or two numbers are at fault, "" if the
        suspect of the abort with this `reason` is. Swapped numbers are only asked for if it moved
        as no command does: swapped wheels have a reason of their own.
        """
        i, self.suspect = self.suspect, None
        if i is None:
            return ""
        first, last = self._seen[0][1], self._seen[-1][1]
        known = [j for j, pair in enumerate(zip(first, last, strict=True)) if None not in pair]
        if len(known) < 2 or i not in known or self._all_stand(known):
            return ""
        swapped = self._swapped(i, known) if AS_NO_COMMAND in reason else ""
        return swapped or self._common_cause(i, known)

    def _all_stand(self, known: Sequence[int]) -> bool:
        """Return whether all of the robots stand: what is at fault are their link, power or
        wheels."""
        now_ns, last, _ = self._seen[-1]
        before = next(p for t, p, _ in self._seen if now_ns - t <= STANDS_NS)
        if None in [before[j] for j in known]:
            return False
        gone = (self._array(last, known) - self._array(before, known))[:, :2]
        return bool(np.all(np.hypot(*gone.T) < STANDS_MM))

    def _common_cause(self, i: int, known: Sequence[int]) -> str:
        """Return a text if camera or radio explain the motion of the robots `known` better than
        robot i does."""
        others = np.array(known) != i
        camera, one = self._camera(known, others)
        radio, coarse, delay_ns = self._radio(known, others)
        if radio + CLEAR < max(coarse, min(camera, one)):
            return RADIO.format(delay_ns / SECOND)
        return CAMERA if camera + CLEAR < one else ""

    def _swapped(self, i: int, known: Sequence[int]) -> str:
        """Return a text if robot i and another of the robots `known` have exchanged numbers."""
        as_own = dict(zip(known, self._misfits(known, known), strict=True))
        for j in known:
            if j == i:
                continue
            exchanged = sum(self._misfits([i, j], [j, i]))
            if exchanged < min(CLEAR, as_own[i] + as_own[j] - CLEAR):
                first, second = sorted((i, j))
                return SWAPPED.format(self._names[first], self._names[second])
        return ""

    def _misfits(self, robots: Sequence[int], commanded: Sequence[int]) -> Floats:
        """Return |z|^2 (K,) of robots with the commands of the robots `commanded` (K,), each at the
        delay up to DELAY_NS that fits best."""
        return self._squares(robots, commanded, DELAY_NS // STEP_NS).min(axis=0)

    def _camera(self, known: Sequence[int], others: np.ndarray) -> tuple[float, float]:
        """Return the sums of the camera and of one robot."""
        found = [self._drift.left_over(j, self._blocks(j)) for j in known]
        z, moves = np.array([z for z, _ in found]), np.vstack([g for _, g in found]) * LIKELY
        g = np.linalg.solve(moves.T @ moves + np.eye(4), moves.T @ z.ravel())
        camera = ((z.ravel() - moves @ g) ** 2).sum() + g @ g
        return camera, (z[others] ** 2).sum()

    def _blocks(self, j: int) -> list[tuple[int, Pose]]:
        """Return the poses of robot j that are at least BLOCK_NS apart, with their times."""
        found: list[tuple[int, Pose]] = []
        for _, poses, times in self._seen:
            pose = poses[j]
            if pose is not None and (not found or times[j] - found[-1][0] >= BLOCK_NS):
                found.append((times[j], pose))
        return found

    def _radio(self, known: Sequence[int], others: np.ndarray) -> tuple[float, float, int]:
        """Return the sums of the radio and of one robot, and the radio's delay [ns]."""
        squares = self._squares(known, known, LATEST_NS // STEP_NS)
        nominal = DELAY_NS // STEP_NS
        radio = squares.sum(axis=1)
        delay = nominal + int(radio[nominal:].argmin())
        one = squares[:nominal, others].sum(axis=1).min()
        return radio[delay], one, delay * STEP_NS

    def _squares(self, robots: Sequence[int], commanded: Sequence[int], delays: int) -> Floats:
        """Return |z|^2 (delays, K) of robots with the commands of the robots `commanded` (K,),
        which act later by 0, 1, ... steps of STEP_NS."""
        (_, first, begun), (_, last, ended) = self._seen[0], self._seen[-1]
        then, now = self._array(first, robots), self._array(last, robots)
        each = np.array([max(1, round((ended[j] - begun[j]) / STEP_NS)) for j in robots])
        steps = int(each.max())
        by_end = {
            end: [
                self._drift.commands.mean(end - k * STEP_NS, STEP_NS) for k in range(delays + steps)
            ]
            for end in {ended[j] for j in robots}
        }
        pairs = zip(robots, commanded, strict=True)
        sent = np.stack([np.array(by_end[ended[i]])[:, :, j] for i, j in pairs], axis=-1)
        sent *= STEP_NS / SECOND
        own = (np.arange(steps)[:, None] < each)[:, None]  # steps between a robot's own two poses
        return np.array(
            [_squares(then, now, (sent[k : k + steps] * own)[::-1]) for k in range(delays)]
        )

    def _array(self, poses: Sequence[Pose | None], known: Sequence[int]) -> Floats:
        seen = [pose for j in known if (pose := poses[j]) is not None]
        return np.array([(p.x * self._mm, p.y * self._mm, p.heading) for p in seen])


def _squares(then: Floats, now: Floats, sent: Floats) -> Floats:
    """Return |z|^2 (n,) of poses `then` and `now` (n, 3), between which the ways and angles `sent`
    (T, 2, n) were commanded.
    """
    way, turns = sent[:, 0], sent[:, 1]
    course = then[:, 2] + np.cumsum(turns, axis=0) - turns / 2
    dx, dy = (now - then)[:, :2].T - [(way * np.cos(course)).sum(0), (way * np.sin(course)).sum(0)]
    cos, sin, around = np.cos(now[:, 2]), np.sin(now[:, 2]), (now - then)[:, 2] - turns.sum(0)
    off = np.column_stack([cos * dx + sin * dy, cos * dy - sin * dx, np.angle(np.exp(1j * around))])
    size = np.column_stack([way.sum(0), way.sum(0), abs(turns).sum(0)])
    return ((off / (NOISE + SHARE * size)) ** 2).sum(axis=1)
