"""Checks with the camera whether robots stand still; an untracked robot counts as moving."""

import math

from tetractl.core.clock import SECOND
from tetractl.core.poses import Pose
from tetractl.experiment.lab_section import STANDSTILL_MM_S, UNTRACKED_STOP_S
from tetractl.lab.accepted_frame import AcceptedFrame
from tetractl.lab.rig import Rig

STANDSTILL_S = 2.0  # longest time after a stop until the camera sees the robots stand still [s]
REST_NS = SECOND // 4  # time for which the camera must see robots stand still


def moving_robots(rig: Rig) -> list[str]:
    """Return one line for each robot that did not stand still during the last `REST_NS`."""
    window = rig.frames.last(REST_NS)
    if not window:
        return [f"{name} has not been watched long enough" for name in rig.setup.names]
    lines = [_not_at_rest(rig, i, window) for i in rig.left]
    return [line for line in lines if line]


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
        if halts and lines and waited >= 2 * REST_NS:
            rig.loop.stop()
        rig.clock.sleep_until(rig.clock.now() + SECOND // 20)


def _stream_lost(rig: Rig) -> list[str]:
    """Return a line that says that no camera frames arrive; [] if frames arrive."""
    silent_ns = rig.silent_ns()
    if rig.frames.newest is None or silent_ns > rig.limits.stream_lost * SECOND:
        return [f"the cameras do not show that the robots stand: {rig.guard.no_frame(silent_ns)}"]
    return []


def _lost(rig: Rig) -> list[str]:
    newest, count = rig.frames.newest, len(rig.setup.names)
    fresh = newest.fresh if newest is not None else (False,) * count
    return [rig.not_tracked(i) for i in rig.left if not fresh[i]]


def _not_at_rest(rig: Rig, i: int, window: list[AcceptedFrame]) -> str:
    """Return why robot i does not count as standing still in the frames of `window`; "" if it
    stands still.
    """
    name, newest = rig.setup.names[i], window[-1].frame.sampled_ns
    seen = [(f.frame.sampled_ns, pose) for f in window if (pose := f.pose(i)) is not None]
    if not seen or newest - seen[-1][0] > UNTRACKED_STOP_S * SECOND:
        return f"{rig.not_tracked(i)}, so it is not seen to stand"
    if seen[-1][0] - seen[0][0] < 0.6 * REST_NS:
        return f"{name} has not been watched long enough"
    speed, turning = _speeds(*seen[0], *seen[-1])
    moves = speed * rig.mm > STANDSTILL_MM_S or turning > 0.3  # rad/s
    return f"{name} still moves" if moves else ""


def _speeds(began: int, first: Pose, ended: int, last: Pose) -> tuple[float, float]:
    """Return the mean speed [length unit/s] and turning rate [rad/s] between two poses."""
    seconds = (ended - began) / SECOND
    gone = math.hypot(last.x - first.x, last.y - first.y)
    return gone / seconds, abs(math.remainder(last.heading - first.heading, math.tau)) / seconds
