"""Checks with the camera whether robots stand still; an untracked robot counts as moving.

A straight line is fitted by least squares to the poses of a robot over the last REST_NS. From n
poses over a time T, each with an error of standard deviation e (estimated from what the line leaves
over), the line's slope has the standard error

    s = e sqrt(12 / n) / T,

and a robot stands still if the slope is at most STILL, or what noise makes of it with a probability
of DOUBT: q s, with q = 4 for many poses and more for few (Student's distribution). While q s is
more than STILL, as with a slow or coarse camera, the line is fitted to a time twice and four times
as long. A jump would pass for noise: of a robot at rest the first and the last pose of the last
REST_NS differ by JUMP_MM at most.
"""

import math
from collections.abc import Iterable

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.poses import Floats, Pose
from tetractl.experiment.lab_section import STANDSTILL_MM_S, UNTRACKED_STOP_S
from tetractl.lab.accepted_frame import AcceptedFrame
from tetractl.lab.rig import Rig

STANDSTILL_S = 2.0  # longest time after a stop until the camera sees the robots stand still [s]
REST_NS = SECOND // 4  # shortest time for which the camera must see robots stand still
LONGER = (1, 2, 4)  # multiples of it, used in turn while the line is not certain
STILL = np.array([2.0, 2.0, 0.02])  # greatest motion of a robot at rest [mm/s, mm/s, rad/s]
JUMP_MM = 1.5 * STANDSTILL_MM_S * REST_NS / SECOND  # less than twice, which `verify` allows
DOUBT = 3e-5  # probability that noise alone exceeds a limit, in each direction
ALIKE = "all robots are seen to move alike ({}), though stopped: do the camera or its origin move?"


def moving_robots(rig: Rig, longer: tuple[int, ...] = LONGER) -> list[str]:
    """Return one line for each robot that did not stand still during the last `REST_NS`, or the
    multiples `longer` of it; or one line for all, if they move in the same way.
    """
    window = rig.frames.last(longer[-1] * REST_NS)
    if not window:
        return [f"{name} has not been watched long enough" for name in rig.setup.names]
    found = [_not_at_rest(rig, i, window, longer) for i in rig.left]
    return _alike(found) or [line for line, _ in found if line] or _jumps(rig, window)


def drifting_robots(rig: Rig, longer: tuple[int, ...] = LONGER) -> list[str]:
    """Return the lines of `moving_robots` of robots that are seen to move, not of unseen ones."""
    window = rig.frames.last(longer[-1] * REST_NS)
    found = [_not_at_rest(rig, i, window, longer) for i in rig.left if window]
    return _alike(found) or [line for line, slope in found if slope is not None]


def wait_for_rest(rig: Rig) -> str:
    """Wait until the camera sees every robot stand still; repeat the stop while any robot moves.
    Robots that cannot stand only have to be tracked.

    Returns a text that names the robots not at rest or not tracked within STANDSTILL_S, ""
    if there are none.
    """
    halts, began = rig.actuator.halts, rig.clock.now()
    while True:
        lines = _stream_lost(rig) or (moving_robots(rig) if halts else _lost(rig))
        newest, waited = rig.frames.newest, rig.clock.now() - began
        watched = not halts or (newest and newest.frame.received_ns - began >= REST_NS)
        if watched and not lines:
            return ""
        if waited >= STANDSTILL_S * SECOND:
            return f"{STANDSTILL_S:g} s after the stop: {'; '.join(lines)}"
        if halts and waited >= 2 * REST_NS and moving_robots(rig, LONGER[:1]):
            rig.loop.stop()
        rig.clock.sleep_until(rig.clock.now() + SECOND // 20)


def _stream_lost(rig: Rig) -> list[str]:
    """Return a line that says that no camera frames arrive; [] if frames arrive."""
    silent_ns = rig.silent_ns()
    if rig.frames.newest is None or silent_ns > rig.limits.stream_lost * SECOND:
        why = rig.guard.why_no_frame(silent_ns)
        return [f"the cameras do not show that the robots stand: {why}"]
    return []


def _lost(rig: Rig) -> list[str]:
    newest, count = rig.frames.newest, len(rig.setup.names)
    fresh = newest.fresh if newest is not None else (False,) * count
    return [rig.not_tracked(i) for i in rig.left if not fresh[i]]


def _not_at_rest(
    rig: Rig, i: int, window: list[AcceptedFrame], longer: tuple[int, ...]
) -> tuple[str, Floats | None]:
    """Return why robot i does not count as standing still in the frames of `window`, "" if it
    stands still; and its motion (3,) [mm/s, mm/s, rad/s], None if it is not seen to move.
    """
    from scipy.special import stdtrit

    name, newest = rig.setup.names[i], window[-1].frame.sampled_ns
    seen = [
        ((at - newest) / SECOND, pose.x * rig.mm, pose.y * rig.mm, pose.heading)
        for at, pose in _seen(window, i)
    ]
    if not seen or -seen[-1][0] > UNTRACKED_STOP_S:
        return f"{rig.not_tracked(i)}, so it is not seen to stand", None
    rows = np.array(seen)
    rows[:, 3] = np.unwrap(rows[:, 3])
    for span_s in (REST_NS / SECOND * times for times in longer):
        part = rows[rows[:, 0] >= -span_s]
        if len(part) < 3 or part[-1, 0] - part[0, 0] < 0.6 * span_s:
            return f"{name} has not been watched long enough", None
        slope, error = _line(part)
        noise = stdtrit(len(part) - 2, 1 - DOUBT) * error
        if np.any(abs(slope) > np.maximum(STILL, noise)):
            return f"{name} still moves ({_rates(slope)})", slope
        if np.all(noise <= STILL):
            break
    return "", None


def _seen(window: list[AcceptedFrame], i: int) -> Iterable[tuple[int, Pose]]:
    """Return the poses of robot i in the frames of `window`, each once, with their times [ns]."""
    return {f.exposed(i): pose for f in window if (pose := f.pose(i)) is not None}.items()


def _jumps(rig: Rig, window: list[AcceptedFrame]) -> list[str]:
    """Return one line for each robot whose pose has jumped within the last `REST_NS`."""
    since, lines = window[-1].frame.sampled_ns - REST_NS, list[str]()
    for i in rig.left:
        poses = [pose for at, pose in _seen(window, i) if at >= since]
        if not poses:
            continue
        by_mm = math.hypot(poses[-1].x - poses[0].x, poses[-1].y - poses[0].y) * rig.mm
        if by_mm > JUMP_MM:
            lines.append(
                f"{rig.setup.names[i]} still moves (by {by_mm:.0f} mm in a quarter second)"
            )
    return lines


def _alike(found: list[tuple[str, Floats | None]]) -> list[str]:
    """Return a line that all robots move in the same way; [] if they do not."""
    slopes = np.array([slope for _, slope in found if slope is not None])
    if len(slopes) < len(found) or len(found) < 2 or np.any(np.ptp(slopes, axis=0) > 2 * STILL):
        return []
    return [ALIKE.format(_rates(slopes.mean(axis=0)))]


def _line(rows: Floats) -> tuple[Floats, Floats]:
    """Return the slopes (3,) of straight lines through rows (n, 4) of times [s] and values, and
    their standard errors (3,).
    """
    middle = rows - rows.mean(axis=0)
    t, values = middle[:, :1], middle[:, 1:]
    squares = float((t**2).sum())
    slope = (t * values).sum(axis=0) / squares
    left = ((values - t * slope) ** 2).sum(axis=0) / (len(rows) - 2)
    return slope, np.sqrt(left / squares)


def _rates(slope: Floats) -> str:
    return f"{math.hypot(slope[0], slope[1]):.0f} mm/s, {slope[2]:+.2f} rad/s"
