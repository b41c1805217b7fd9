"""Compares what a camera shows over the whole trial with what the robots' wheels can have done.

The window of `motion_check` must allow for every command that may be acting, and so cannot see a
pose that leaves its robot slowly. Here the motion of each block of BLOCK_NS, along, across and
around the heading, is fitted by least squares over the whole trial. A robot of wheel distance r,
commanded a speed v and a turning rate w, moves by

    along:   (1 + s) v + d w r + l w,   across: b v + f w,   around:  (1 + s + k) w + d v / r,

where s is the mean error of its wheels and d half their difference, k the error of 1 / r, b that of
its heading, and (f, l) where its pose is measured from. Each is unknown but constant, with a normal
prior. A command acts after a delay between the TAPS: weights of the earlier and later ones are
fitted too. What no command explains is

    one robot:   a constant velocity along, across and around its heading,
    the camera:  one shift, turn and growth of the whole picture, of all robots,

since some moment of the trial: for each moment of a grid, the statistic is the gain of the sum of
squares by the best such motion (a generalised likelihood ratio over the time of a change; a
cumulative sum is the case of known parameters). The grid begins with the trial, so a motion that
was there from the start is found as far as no error of a wheel explains it. A lost packet matters
the more the commands differ: so much more uncertain is the block, and by a fifth of it those up to
a quarter second later. Lengths are mm.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.poses import UNSTATED, Floats, Pose, Sight
from tetractl.lab.command_history import CommandHistory
from tetractl.lab.motion_check import ANOTHER, KINDS, WATCHDOG_NS, motion
from tetractl.model.motion.rolling import rolled

BLOCK_NS = SECOND // 20
TAPS_NS = (SECOND // 20, 0, 3 * SECOND // 25, SECOND // 4)  # delays, the nominal one first
BEFORE_NS = (*TAPS_NS, 37 * SECOND // 200)  # and one between the last two, which has no weight
NOISE = np.array([0.4, 0.4, 0.005])  # of a pose [mm, mm, rad]
LATEST = 3  # taps within which commands differ where a packet is lost
SLIP = np.array([1.5, 1.5, 0.02])  # random walk of a robot [mm, mm, rad, each per sqrt(s)]
LOST = np.array([0.15, 0.0, 0.15])  # error of a motion, over how much the commands differ
LAGS = LOST / 5  # of it, what wheels of a lag of 80 ms leave 0.13 s later: from 0.18 s before on
CLIP = 1.7  # standard deviations beyond which a residual counts no more
# standard deviations of s, k, d, b, f, l (see the module) and of the weights of delays
PRIOR = np.array([0.04, 0.05, 0.04, 0.06, 5.0, 1.0, *[0.2] * (2 * len(TAPS_NS) - 2)])
KNOWN = len(PRIOR)
ERRORS = np.zeros((3, KNOWN))  # of the left and right wheel and the heading, by these
ERRORS[:, [0, 2, 3]] = (1, -1, 0), (1, 1, 0), (0, 0, 1)
LARGEST = np.array([500.0, 500.0, 5.0, 500.0, 500.0, 5.0, 5.0]) ** -2  # of motions [mm/s, rad/s]
LEAST_BLOCKS = 12  # younger changes are left to `motion_check`; lost packets make 7 wrong alike
SPACING, GRID = 5, 32  # blocks between two moments of the grid, and the most moments
LIMIT = 16.0  # good trials of the emulated lab reach 13 (docs/decisions/guard.md)
STEADY = 0.25  # largest error of wheels whose error is constant; a dead zone causes a larger one
SURE = 3.0  # standard deviations by which a wheel must be beyond its largest error
LEAST_KNOWN = 0.01  # share of the prior's variance that a trial must have explained
TOGETHER = "all robots drift together: has the camera, its origin or its scale moved?"
TURNS = (
    "robots turn by themselves while they drive, by wheels that differ or by poses false since "
    "the start, which this trial alone cannot distinguish: {}"
)
WRONG = (
    "{}'s left wheel is {:+.0%} off its commanded speed, and its right one {:+.0%}: is it "
    "calibrated, or does the camera track another body as this robot?"
)

Found = tuple[str, tuple[int, ...]]
NOTHING: Found = "", ()


class DriftCheck:
    """Checks N robots of wheel distance `radius` and wheels that are wrong by up to `share`; `mm`
    is the number of millimetres per length unit of what it is given, `sight` what the camera sees.
    """

    def __init__(
        self,
        names: Sequence[str],
        radius: float,
        mm: float,
        share: float,
        sight: Sight = UNSTATED,
    ) -> None:
        self._noise = np.hypot(NOISE, sight.spread)
        self._names, self._mm, self._share = names, mm, share
        self._radius = radius * mm
        self.commands = CommandHistory(2, len(names))  # speeds [mm/s] and turning rates [rad/s]
        n, size = len(names), 1 + KNOWN + len(LARGEST)
        self._sums = np.zeros((n, size, size))  # of products of residual, regressors and motions
        self._grid: list[tuple[int, Floats]] = [(0, self._sums.copy())]
        self._blocks = 0
        self._fastest = np.zeros(n)  # greatest speeds commanded [mm/s]
        self._spread = np.array([np.diag(PRIOR**2)] * n)  # covariance of the fit
        self._fit = np.zeros((n, KNOWN))
        # ways beyond CLIP, counted in the next blocks; a turn may be of a lost packet
        self._carried = np.zeros((n, 3))
        self._last: list[tuple[Pose | None, int]] = [(None, 0)] * n
        self._coarse = sight.coarse
        self.worst = 0.0  # the statistic, at the worst moment of the grid
        self.rest()

    def rest(self) -> None:
        """Leave out the motion from the last pose to the next, but keep the fit; called when robots
        start from rest.
        """
        self._then_ns = 0
        self._carried[:] = 0.0
        # each robot's pose, motion and time [ns] at the begin of the block
        self._then: list[tuple[Pose, Floats, int] | None] = [None] * len(self._names)

    def sent(self, now_ns: int, speed: Sequence[float], turning: Sequence[float]) -> None:
        """Take a transmission: the robots' speeds [length unit/s] and turning rates [rad/s]."""
        speeds = np.array(speed) * self._mm
        self._fastest = np.maximum(self._fastest, speeds)
        self.commands.sent(now_ns, np.array([speeds, turning]))

    def frame(
        self, now_ns: int, times: Sequence[int], poses: Sequence[Pose | None], seen: Floats
    ) -> Found:
        """Take the last accepted poses (N,) at a frame, their `times` (N,) [ns], and the robots'
        motion `seen` (N, 3) since their rest. Return what is wrong: a text, "" if nothing is, and
        the robots whose poses are false. Poses that repeat are left out. Wheels that may be wrong
        by more than STEADY, as before they are calibrated, would explain any drift.
        """
        dt_ns = now_ns - self._then_ns
        last, self._last = self._last, [*zip(poses, times, strict=True)]
        pairs = zip(self._last, last, strict=True)
        poses = [None if self._repeats(*pair) else pair[0][0] for pair in pairs]
        if dt_ns < BLOCK_NS or self._share > STEADY:
            return NOTHING
        moved = seen * (self._mm, self._mm, 1.0)
        if dt_ns < WATCHDOG_NS:
            blocks: list[tuple[int, Pose, Floats, tuple[int, int]]] = []
            for i, (then, pose) in enumerate(zip(self._then, poses, strict=True)):
                if then is not None and pose is not None and times[i] > then[2]:
                    before, was, then_ns = then
                    blocks.append((i, before, moved[i] - was, (times[i], times[i] - then_ns)))
            if blocks:
                self._add(*zip(*blocks, strict=True))
            self._blocks += 1
        self._then_ns = now_ns
        self._then = [p and (p, way, at) for p, way, at in zip(poses, moved, times, strict=True)]
        return self._fault() if self._blocks % 2 == 0 else NOTHING

    def carried(self, i: int, pose: Pose, then_ns: int, late_ns: int) -> Pose:
        """Return a pose of robot i as it will be `late_ns` later, by the commands sent."""
        v, w = self.commands.mean(then_ns + late_ns - TAPS_NS[0], late_ns)[:, i]
        way, turned = v / self._mm * late_ns / SECOND, w * late_ns / SECOND
        dx, dy = rolled(pose.heading, turned, way)
        return replace(pose, x=pose.x + dx, y=pose.y + dy, heading=pose.heading + turned)

    def _repeats(self, now: tuple[Pose | None, int], last: tuple[Pose | None, int]) -> bool:
        """Return whether a pose, with its time, is no new measurement."""
        return now[0] == last[0] and now[1] != last[1] and not self._coarse

    def turns(self) -> str:
        """Return a text about robots that turn by themselves while they drive, by more than SURE
        standard deviations; "" if none does. Their wheels differ, or their poses are false since
        the start: one trial cannot distinguish them.
        """
        found = [
            f"{name} {rate:+.2f} ± {error:.2f} rad/s"
            for name, rate, error in zip(self._names, *self.turning(), strict=False)
            if abs(rate) > SURE * error
        ]
        return TURNS.format(", ".join(found)) if found else ""

    def turning(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return the rates (N,) at which the robots turn by themselves when they drive as fast as
        they were commanded at most, and their standard errors, inf for robots that did not drive
        [rad/s]; both empty if none is known.

        The prior of d is taken out again, so that trials of one robot can be compared: d known by
        m with the variance q, of which the prior is p, has the rate v / r m / (1 - q / p) and the
        variance (v / r)^2 q / (1 - q / p).
        """
        per = self._fastest / self._radius if self._radius else 0.0 * self._fastest
        variance = self._spread[:, 2, 2]
        share = 1.0 - variance / PRIOR[2] ** 2
        known = (share > LEAST_KNOWN) & (per > 0.0)
        share = np.where(known, share, 1.0)
        rates = np.where(known, per * self._fit[:, 2] / share, 0.0)
        errors = np.where(known, per * np.sqrt(variance / share), np.inf)
        return (tuple(rates.tolist()), tuple(errors.tolist())) if known.any() else ((), ())

    def left_over(self, i: int, seen: Sequence[tuple[int, Pose]]) -> tuple[Floats, Floats]:
        """Return what commands and wheels do not explain of the motion of robot i over its poses
        `seen`, at times [ns]: z (3,), in standard deviations, and its regressors on a shift, turn
        and growth of the picture (3, 4) [mm/s, mm/s, rad/s, 1/s].
        """
        total, variance = np.zeros((3, 1 + KNOWN + len(LARGEST))), 2 * self._noise**2
        for (then_ns, then), (now_ns, now) in pairwise(seen):
            moved = motion(then, now) * (self._mm, self._mm, 1.0)
            x, walk = self._regressors([i], [then], moved[None], [(now_ns, now_ns - then_ns)])
            total, variance = total + x[0], variance + walk[0]
        known = total[:, 1 : 1 + KNOWN]
        variance = variance + np.einsum("rp,pq,rq->r", known, self._spread[i], known)
        off, spread = total[:, 0] - known @ self._fit[i], np.sqrt(variance)
        return off / spread, total[:, 4 + KNOWN :] / spread[:, None]

    def _commanded(self, robots: Sequence[int], spans: Sequence[tuple[int, int]]) -> Floats:
        """Return what was commanded to robots over the `spans` that end at a time and are so long,
        [ns], with each delay: (K, TAPS + 1, 2)."""
        taps = {
            (until_ns, dt_ns): [self.commands.mean(until_ns - tap, dt_ns) for tap in BEFORE_NS]
            for until_ns, dt_ns in set(spans)
        }
        every = np.array([taps[span] for span in spans])
        return every[np.arange(len(robots)), :, :, robots]

    def _regressors(
        self,
        robots: Sequence[int],
        then: Sequence[Pose],
        moved: Floats,
        spans: Sequence[tuple[int, int]],
    ) -> tuple[Floats, Floats]:
        """Return residuals and regressors (K, 3, 1 + KNOWN + 7) of blocks that began at the poses
        `then` (K,), in which robots `moved` (K, 3) over `spans`; and the variances (K, 3) of those
        motions.
        """
        every = self._commanded(robots, spans)
        sent = every[:, : len(TAPS_NS)]
        dt = np.array([dt_ns / SECOND for _, dt_ns in spans])
        r, (v, w) = self._radius, sent[:, 0].T * dt
        x = np.zeros((len(robots), 3, 1 + KNOWN + len(LARGEST)))
        x[:, :, 0] = moved
        x[:, 0, 0] -= v
        x[:, 2, 0] -= w
        others, taps = (sent[:, 1:] - sent[:, :1]) * dt[:, None, None], 1 + 6 + len(TAPS_NS) - 1
        x[:, 0, 1], x[:, 0, 3], x[:, 0, 6], x[:, 0, 7:taps] = v, w * r, w, others[:, :, 0]
        x[:, 1, 4], x[:, 1, 5] = v, w
        x[:, 2, 1] = x[:, 2, 2] = w
        x[:, 2, 3], x[:, 2, taps : 1 + KNOWN] = v / r if r else 0.0, others[:, :, 1]
        px, py, heading = np.array([(one.x, one.y, one.heading) for one in then]).T
        cos, sin, px, py = np.cos(heading), np.sin(heading), px * self._mm, py * self._mm
        shift = np.array([[1.0 + 0 * px, 0 * px, -py, px], [0 * px, 1.0 + 0 * px, px, py]])
        axes = np.array([[cos, sin], [-sin, cos]]).transpose(2, 0, 1)
        x[:, :, 1 + KNOWN : 4 + KNOWN] = np.eye(3) * dt[:, None, None]
        x[:, :2, 4 + KNOWN :] = axes @ shift.transpose(2, 0, 1) * dt[:, None, None]
        x[:, 2, 6 + KNOWN] = dt
        unlike = np.ptp(sent[:, :LATEST], axis=1)[:, [0, 0, 1]] * dt[:, None]
        before = np.abs(every[:, LATEST:] - sent[:, :1]).max(axis=1)[:, [0, 0, 1]] * dt[:, None]
        return x, SLIP**2 * dt[:, None] + (LOST * unlike) ** 2 + (LAGS * before) ** 2

    def _add(
        self,
        robots: Sequence[int],
        then: Sequence[Pose],
        moved: Sequence[Floats],
        spans: Sequence[tuple[int, int]],
    ) -> None:
        """Add blocks of robots, which `moved` (K, 3) from the poses `then`, over `spans` [ns]."""
        rows = list(robots)
        x, walk = self._regressors(robots, then, np.array(moved) + self._carried[rows], spans)
        spread = np.sqrt(2 * self._noise**2 + walk)
        x /= spread[:, :, None]
        known, covariance = x[:, :, 1 : 1 + KNOWN], self._spread[rows]
        expected = (known @ self._fit[rows, :, None])[..., 0]
        bound = CLIP * np.sqrt(1 + ((known @ covariance) * known).sum(axis=2))
        whole = x[:, :, 0].copy()
        x[:, :, 0] = np.clip(whole, expected - bound, expected + bound)
        self._carried[rows, :2] = ((whole - x[:, :, 0]) * spread)[:, :2]
        self._sums[rows] += x.swapaxes(1, 2) @ x

    def _fault(self) -> Found:
        sums, known, motion = self._sums, slice(1, 1 + KNOWN), slice(1 + KNOWN, None)
        self._spread = np.linalg.inv(sums[:, known, known] + np.diag(PRIOR**-2.0))
        self._fit = np.einsum("npq,nq->np", self._spread, sums[:, known, 0])
        squares = sums[:, 0, 0] - np.einsum("np,np->n", self._fit, sums[:, known, 0])
        count = 3.0 * max(self._blocks, 1)
        self.worst = 0.0
        old = [then for block, then in self._grid if self._blocks - block >= LEAST_BLOCKS]
        if not old:
            return self._next(sums, NOTHING)
        since = sums - np.array(old)  # (G, N, ...), as all that follows
        mixed = since[..., known, motion]
        left = since[..., motion, motion] - mixed.swapaxes(2, 3) @ self._spread @ mixed
        pull = since[..., motion, 0] - (self._fit[:, None] @ mixed)[..., 0, :]
        one = np.linalg.solve(left[..., :3, :3] + np.diag(LARGEST[:3]), pull[..., :3, None])[..., 0]
        gain = (pull[..., :3] * one).sum(axis=2)
        gain /= np.maximum(1.0, (squares - gain) / count)  # noise above that assumed
        noise = np.maximum(1.0, squares / count)[:, None]
        total = (pull[..., 3:] / noise).sum(axis=1)
        every = (left[..., 3:, 3:] / noise[..., None]).sum(axis=1) + np.diag(LARGEST[3:])
        shift = np.linalg.solve(every, total[..., None])[..., 0]
        together = (total * shift).sum(axis=1) if len(squares) > 1 else np.zeros(len(old))
        alone = gain.max(axis=1)
        g = int(np.maximum(alone, together).argmax())
        i, self.worst = int(gain[g].argmax()), float(max(alone[g], together[g]))
        found = self._of_one(i, pull[g, i, :3] * one[g, i])
        if together[g] > alone[g]:
            each = (2 * pull[g, :, 3:] - left[g, :, 3:, 3:] @ shift[g]) @ shift[g] / noise[:, 0]
            i = int(each.argmax())
            found = self._of_one(i, pull[g, i, :3] * one[g, i])
            if each.sum() - each[i] > LIMIT / 4:  # it explains the others' motion as well
                found = TOGETHER, tuple(range(len(squares)))
        return self._next(sums, found)

    def _of_one(self, i: int, gains: Floats) -> Found:
        """Return that robot i moves by itself, in the way that has the greatest of `gains` (3,)."""
        return f"{self._names[i]} {ANOTHER.format(KINDS[int(gains.argmax())])}", (i,)

    def _next(self, sums: Floats, found: Found) -> Found:
        """Keep the moment, if it is one of the grid; return what was found, if it is enough."""
        if self._blocks - self._grid[-1][0] >= SPACING:
            self._grid.append((self._blocks, sums.copy()))
            if len(self._grid) > GRID:  # old moments are kept less densely
                del self._grid[1 : 3 * GRID // 4 : 2]
        return found if self.worst > LIMIT else self._wheels()

    def _wheels(self) -> Found:
        """Return which robot's wheels or heading are wrong by more than allowed."""
        wrong = self._fit @ ERRORS.T  # (N, 3)
        spread = np.einsum("ep,npq,eq->ne", ERRORS, self._spread, ERRORS)
        sure = np.abs(wrong) - SURE * np.sqrt(spread) > self._share
        for name, each, far in zip(self._names, wrong, sure, strict=True):
            if far[2]:
                return f"{name} {ANOTHER.format(KINDS[1])}", ()
            if far.any():
                return WRONG.format(name, *each), ()
        return NOTHING
