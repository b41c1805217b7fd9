"""Finds whether one robot, the camera or the radio is at fault when a pose contradicts commands.

What robots have done in the last WINDOW_NS differs from what they were commanded by z_j (3,), in
standard deviations. Of the explanations

    one robot i:  the others follow their commands,    sum of |z_j|^2 over j != i
    the camera:   its picture shifts, turns and grows, least sum of |z_j - G_j g|^2 + |g|^2
    the radio:    all follow their commands later,     sum of |z_j|^2 with delayed commands

one of the last two must be better than the first by CLEAR. G_j g is the motion of pose j if the
picture moves at g, over LIKELY rates. For the camera, motion is compared as in `drift_check`; for
the radio, commands are integrated with each delay up to LATEST_NS, and the first explanation may
have any delay up to DELAY_NS. Lengths are mm.
"""

from collections import deque
from collections.abc import Sequence

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.poses import Floats, Pose
from tetractl.lab.drift_check import BLOCK_NS, DriftCheck
from tetractl.lab.motion_check import DELAY_NS

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


class Culprit:
    """Keeps what the camera shows of N robots whose motion `drift` follows; `mm` is the number of
    millimetres per length unit.
    """

    def __init__(self, drift: DriftCheck, mm: float) -> None:
        self._drift, self._mm = drift, mm
        self._seen: deque[tuple[int, Sequence[Pose | None], Sequence[int]]] = deque()
        self.suspect: int | None = None  # the robot that a run was aborted for

    def see(self, now_ns: int, poses: Sequence[Pose | None], times: Sequence[int]) -> None:
        """Take a frame's poses, accepted or not, and their times (N,) [ns]."""
        self._seen.append((now_ns, poses, times))
        while now_ns - self._seen[0][0] > WINDOW_NS:
            self._seen.popleft()

    def why(self) -> str:
        """Return, once, a text if the camera or the radio is at fault, "" if the suspect is."""
        i, self.suspect = self.suspect, None
        return "" if i is None else self._why(i)

    def _why(self, i: int) -> str:
        first, last = self._seen[0][1], self._seen[-1][1]
        known = [j for j, pair in enumerate(zip(first, last, strict=True)) if None not in pair]
        if len(known) < 2 or i not in known:
            return ""
        before = next(p for t, p, _ in self._seen if self._seen[-1][0] - t <= STANDS_NS)
        if None not in [before[j] for j in known]:
            gone = (self._array(last, known) - self._array(before, known))[:, :2]
            if np.all(np.hypot(*gone.T) < STANDS_MM):  # all stand: their link, power or wheels
                return ""
        others = np.array(known) != i
        camera, one = self._camera(known, others)
        radio, coarse, delay_ns = self._radio(known, others)
        if radio + CLEAR < max(coarse, min(camera, one)):
            return RADIO.format(delay_ns / SECOND)
        return CAMERA if camera + CLEAR < one else ""

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
        (_, first, begun), (_, last, ended) = self._seen[0], self._seen[-1]
        then, now = self._array(first, known), self._array(last, known)
        each = np.array([max(1, round((ended[j] - begun[j]) / STEP_NS)) for j in known])
        steps, late = int(each.max()), range(LATEST_NS // STEP_NS)
        by_end = {
            end: [
                self._drift.commands.mean(end - k * STEP_NS, STEP_NS)
                for k in range(len(late) + steps)
            ]
            for end in {ended[j] for j in known}
        }
        sent = np.stack([np.array(by_end[ended[j]])[:, :, j] for j in known], axis=-1)
        sent *= STEP_NS / SECOND
        own = (np.arange(steps)[:, None] < each)[:, None]  # steps between a robot's own two poses
        squares = np.array([_squares(then, now, (sent[k : k + steps] * own)[::-1]) for k in late])
        nominal = DELAY_NS // STEP_NS
        radio = squares.sum(axis=1)
        delay = nominal + int(radio[nominal:].argmin())
        one = squares[:nominal, others].sum(axis=1).min()
        return radio[delay], one, delay * STEP_NS

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
