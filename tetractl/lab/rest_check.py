"""Checks with the camera whether robots stand still; an untracked robot counts as moving.

A straight line is fitted by least squares to the poses of a robot over the last REST_NS. From n
poses over a time T, each with an error of standard deviation e (estimated from what the line leaves
over), the line's slope has the standard error

    s = e sqrt(12 / n) / T,

and a robot stands still if the slope is at most STILL, or what noise makes of it with a probability
of DOUBT: q s, with q = 4 for many poses and more for few (Student's distribution). While q s is
more than STILL, as with a slow or coarse camera, nothing is said, and the line is fitted to a time
twice and four times as long. A jump would pass for noise: of a robot at rest the first and the last
pose of the last REST_NS differ by JUMP_MM at most.

After a trial (`wait_for_rest`) stops are repeated while a robot is seen to move, once robots have
had STANDS_NS to stand: after an abort in a pause they have had it already. After STANDSTILL_S
the trial does not count. As plain stops did not hold the robots then, or PLAIN_S after an abort,
since another program drives them or they hear late, the stop that robots latch is sent until all
stand, for UNREST_S at most. After an abort the robots are watched for WATCHED_S, though they stand.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.poses import Floats
from tetractl.experiment.lab_section import STANDSTILL_MM_S, UNTRACKED_STOP_S
from tetractl.lab.frames import AcceptedFrame, as_shown, timed_poses
from tetractl.lab.guard import GuardState
from tetractl.lab.rig import Rig

STANDSTILL_S = 2.0
"""Longest time after a stop until the camera sees the robots stand still [s]."""
WATCHED_S = 3.0
"""Shortest time for which robots are watched after an abort [s]: some have obeyed 2 s late."""
PLAIN_S = 1.25
"""Time after an abort for which plain stops have to hold [s]: wheels roll on for 0.55 s, and half a
second of poses is examined."""
UNREST_S = 5.0
"""Longest time for which the latched stop is repeated, since the first stop [s]: twice what a robot
that is 2 s late needs, and a half."""
REST_NS = SECOND // 4
"""Shortest time for which the camera must see robots stand still."""
STANDS_NS = 3 * REST_NS
"""Time after the last command to move after which robots have stood for REST_NS: until then, wheels
may roll on for 0.5 s."""
LONGER = (1, 2, 4)
"""Multiples of it, used in turn while the line is not certain."""
COVERED = 0.6
"""Least share of a time that the poses must cover to which a line is fitted."""
STILL = np.array([2.0, 2.0, 0.02])
"""Greatest motion of a robot at rest [mm/s, mm/s, rad/s]."""
JUMP_MM = 1.5 * STANDSTILL_MM_S * REST_NS / SECOND
"""Greatest distance between two poses at rest [mm]: less than twice, which `verify` allows."""
DOUBT = 3e-5
"""Probability that noise alone exceeds a limit, in each direction."""
LOOK_NS = SECOND // 20
"""Time between two looks at robots that come to rest."""
LATCHED = (
    "only an emergency stop held the robots: end the program that drives them, and switch them off "
    "and on"
)
TOO_SHORT = "has not been watched long enough"
ALIKE = "all robots are seen to move alike ({}), though stopped: do the camera or its origin move?"


@dataclass(frozen=True, slots=True)
class RestFinding:
    """Why a robot does not count as standing still, "" if it stands still; and its motion (3,)
    [mm/s, mm/s, rad/s], None if it is not seen to move.
    """

    text: str = ""
    motion: Floats | None = None


STANDS_STILL = RestFinding()


@dataclass(frozen=True, slots=True)
class Rest:
    """How robots came to rest after a trial: the `fault` why it does not count, "" if all stood
    within STANDSTILL_S; the names of the robots that are still seen `moving`, and of those that are
    `unseen`; and whether a `latched` stop was needed.
    """

    fault: str = ""
    moving: tuple[str, ...] = ()
    unseen: tuple[str, ...] = ()
    latched: bool = False

    @property
    def reason(self) -> str:
        """Why the trial does not count, with the robots that move; the fault names unseen ones."""
        return joined(self.fault, self._restless)

    @property
    def unrest(self) -> str:
        """What a person has to know of robots that may still drive, "" for nothing."""
        if not self.unseen:
            return self._restless
        them = "it" if len(self.unseen) == 1 else "them"
        return joined(
            self._restless, f"not seen to stand: {', '.join(self.unseen)}: look at {them}"
        )

    @property
    def _restless(self) -> str:
        """What is said of robots that still move, or once all stand by a latched stop."""
        if not self.moving:
            return LATCHED if self.latched else ""
        them = "it" if len(self.moving) == 1 else "them"
        return f"still moves: {', '.join(self.moving)}: switch {them} off"


def joined(*texts: str) -> str:
    """Return the texts that are not empty, in one."""
    return "; ".join(text for text in texts if text)


def moving_robots(rig: Rig, longer: Sequence[int] = LONGER) -> list[str]:
    """Return one line for each robot that did not stand still during the last `REST_NS`, or the
    multiples `longer` of it; or one line for all, if they move in the same way.
    """
    return [finding.text for finding in _not_at_rest(rig, longer)]


def drifting_robots(rig: Rig, longer: Sequence[int] = LONGER) -> list[str]:
    """Return the lines of `moving_robots` of robots that are seen to move, not of unseen ones."""
    return [f.text for f in _not_at_rest(rig, longer) if f.motion is not None]


def _not_at_rest(rig: Rig, longer: Sequence[int]) -> list[RestFinding]:
    """Return the findings of `moving_robots`."""
    window = rig.loop.frames.last(longer[-1] * REST_NS)
    if not window:
        return [RestFinding(f"{name} {TOO_SHORT}") for name in rig.setup.names]
    findings = [_at_rest(rig, i, window, longer) for i in rig.left]
    alike = _moving_alike(findings)
    if alike is not None:
        return [alike]
    return [finding for finding in findings if finding.text] or _jumped(rig, window)


def wait_for_rest(rig: Rig, hurried: Callable[[], bool] = lambda: False) -> Rest:
    """Wait until the camera sees every robot stand still; repeat the stop while any robot moves, as
    the head of this module says. Robots that cannot stand only have to be tracked.

    Once `hurried` is true, it ends STANDSTILL_S after the stop, with one latched stop.
    """
    halts = rig.actuator.halts
    began_ns = rig.clock.now()
    fault = ""
    latched = False
    while True:
        newest = rig.loop.frames.newest
        lines = _stream_lost(rig)
        if not lines and halts:
            lines = moving_robots(rig)
        elif not lines and newest is not None:
            lines = [rig.not_tracked(i) for i in rig.left if not newest.fresh[i]]
        waited_s = (rig.clock.now() - began_ns) / SECOND
        aborted = rig.loop.guard.state is GuardState.ABORT
        watched = waited_s >= WATCHED_S or not (halts and aborted) or hurried()
        seen_ns = 0 if newest is None else newest.frame.received_ns - began_ns
        if not lines and watched and (not halts or seen_ns >= REST_NS):
            return Rest(fault, latched=latched)
        if lines and waited_s >= STANDSTILL_S:
            fault = fault or f"{STANDSTILL_S:g} s after the stop: {'; '.join(lines)}"
        if lines and waited_s >= (PLAIN_S if aborted else STANDSTILL_S):
            moving, unseen = _restless(rig) if halts else ([], [])
            if moving and not rig.loop.guard.emergency:
                rig.loop.guard.abort(fault, emergency=True)
                latched = True
                rig.loop.stop()
            ends = hurried() or waited_s >= UNREST_S or not moving
            if fault and watched and ends:
                return Rest(fault, tuple(moving), tuple(unseen), latched)
        has_had_time = rig.clock.now() - rig.loop.driven_ns >= STANDS_NS
        if halts and has_had_time and moving_robots(rig, LONGER[:1]):
            rig.loop.stop()
        rig.clock.sleep_until(rig.clock.now() + LOOK_NS)


def _restless(rig: Rig) -> tuple[list[str], list[str]]:
    """Return the names of the robots that the camera shows moving, also by poses that the guard
    refuses, none if all move alike, as then the camera does; and of those that it does not show."""
    window = rig.loop.frames.last(LONGER[1] * REST_NS)
    if not window or _stream_lost(rig):
        return [], [rig.setup.names[i] for i in rig.left]
    frames = [as_shown(accepted.frame) for accepted in window]
    findings = [_at_rest(rig, i, frames, LONGER[:2]) for i in rig.left]
    moving: list[str] = []
    unseen: list[str] = []
    for i, finding in zip(rig.left, findings, strict=True):
        if finding.motion is not None or _jump_mm(rig, i, frames) > JUMP_MM:
            moving.append(rig.setup.names[i])
        elif finding.text:
            unseen.append(rig.setup.names[i])
    return [] if _moving_alike(findings) is not None else moving, unseen


def _stream_lost(rig: Rig) -> list[str]:
    """Return a line that says that no camera frames arrive; [] if frames arrive."""
    silent_ns = rig.silent_ns()
    if rig.loop.frames.newest is None or silent_ns > rig.limits.stream_lost * SECOND:
        why = rig.loop.guard.why_no_frame(silent_ns)
        return [f"the cameras do not show that the robots stand: {why}"]
    return []


def _at_rest(
    rig: Rig, i: int, window: Sequence[AcceptedFrame], longer: Sequence[int]
) -> RestFinding:
    """Return what the frames of `window` show of robot i."""
    from scipy.special import stdtrit

    name = rig.setup.names[i]
    rows = _rows(window, i, rig.mm)
    if not len(rows) or -rows[-1, 0] > UNTRACKED_STOP_S:
        return RestFinding(f"{rig.not_tracked(i)}, so it is not seen to stand")
    slope = np.zeros(3)
    limit = STILL
    for times in longer:
        span_s = REST_NS / SECOND * times
        part = rows[rows[:, 0] >= -span_s]
        if len(part) < 3 or part[-1, 0] - part[0, 0] < COVERED * span_s:
            return RestFinding(f"{name} {TOO_SHORT}")
        # straight lines through the values over time, and the variances of their slopes
        (slope, _), covariance = np.polyfit(part[:, 0], part[:, 1:], 1, cov=True)
        noise = stdtrit(len(part) - 2, 1 - DOUBT) * np.sqrt(covariance[0, 0])
        limit = np.maximum(STILL, noise)
        if np.all(noise <= STILL):
            break
    if np.any(abs(slope) > limit):
        return RestFinding(f"{name} still moves ({_rates(slope)})", slope)
    return STANDS_STILL


def _rows(window: Sequence[AcceptedFrame], i: int, mm: float) -> Floats:
    """Return the poses of robot i in the frames of `window` (n, 4): time before the newest frame,
    at most 0 [s], position [mm] and heading, not wrapped [rad].
    """
    newest_ns = window[-1].frame.sampled_ns
    rows: list[tuple[float, float, float, float]] = []
    # a pose that a later frame shows again counts once
    by_time = {timed.exposed_ns: timed.pose for timed in timed_poses(window, i)}
    for exposed_ns, pose in by_time.items():
        time_s = (exposed_ns - newest_ns) / SECOND
        rows.append((time_s, pose.x * mm, pose.y * mm, pose.heading))
    if not rows:
        return np.empty((0, 4))
    array = np.array(rows)
    array[:, 3] = np.unwrap(array[:, 3])
    return array


def _jumped(rig: Rig, window: Sequence[AcceptedFrame]) -> list[RestFinding]:
    """Return a finding for each robot whose pose has jumped within the last `REST_NS`."""
    findings: list[RestFinding] = []
    for i in rig.left:
        jump_mm = _jump_mm(rig, i, window)
        if jump_mm > JUMP_MM:
            by = f"by {jump_mm:.0f} mm in a quarter second"
            findings.append(RestFinding(f"{rig.setup.names[i]} still moves ({by})"))
    return findings


def _jump_mm(rig: Rig, i: int, window: Sequence[AcceptedFrame]) -> float:
    """Return how far apart the first and the last pose of robot i within the last `REST_NS` are,
    0 without poses."""
    since_ns = window[-1].frame.sampled_ns - REST_NS
    poses = [timed.pose for timed in timed_poses(window, i) if timed.exposed_ns >= since_ns]
    if not poses:
        return 0.0
    return poses[-1].distance_to(poses[0]) * rig.mm


def _moving_alike(findings: Sequence[RestFinding]) -> RestFinding | None:
    """Return that all robots move in the same way; None if they do not, or if all turn on the spot:
    a picture that turned would move them differently."""
    motions = [finding.motion for finding in findings if finding.motion is not None]
    if len(motions) < len(findings) or len(findings) < 2:
        return None
    array = np.array(motions)
    if np.any(np.ptp(array, axis=0) > 2 * STILL) or np.all(abs(array[:, 2]) > 2 * STILL[2]):
        return None
    mean = array.mean(axis=0)
    return RestFinding(ALIKE.format(_rates(mean)), mean)


def _rates(motion: Floats) -> str:
    """Return a motion (3,) [mm/s, mm/s, rad/s] as text."""
    return f"{math.hypot(motion[0], motion[1]):.0f} mm/s, {motion[2]:+.2f} rad/s"
