"""Whether robots stand still, by the camera."""

import math

from tetractl.core.clock import SECOND
from tetractl.core.poses import CameraFrame
from tetractl.lab.rig import Rig

REST_NS = SECOND // 4  # robots must stand still for this long
WATCHED = 0.6  # share of it that the frames must span
LOOK_NS = SECOND // 20


def moving(rig: Rig) -> list[str]:
    """Return who moved within the last frames, or was not watched long enough, a line each."""
    frames = tuple(rig.recent)
    if not frames:
        return []
    newest = frames[-1]
    window = [f for f in frames if newest.sampled_ns - f.sampled_ns <= REST_NS]
    span_ns = newest.sampled_ns - window[0].sampled_ns
    if span_ns < WATCHED * REST_NS:
        return [f"{name} has not been watched long enough" for name in rig.setup.names]
    speeds = [_speed_mm(rig, i, window) for i in range(len(rig.setup.names))]
    limit = rig.limits.standstill_mm
    named = zip(rig.setup.names, speeds, strict=True)
    return [f"{name} still moves" for name, speed in named if speed > limit]


def unrest(rig: Rig) -> str:
    """Wait until the robots stand still; return who does not in time, "" where all do."""
    limit_ns = round(rig.limits.standstill * SECOND)
    lost_ns = round(rig.limits.stream_lost * SECOND)
    began = rig.clock.now()
    while True:
        rig.clock.sleep_until(rig.clock.now() + LOOK_NS)
        if not (newest := rig.camera.newest):
            return ""
        now = rig.clock.now()
        blind = now - newest.received_ns > lost_ns
        restless = [] if blind else moving(rig)
        if newest.received_ns - began >= REST_NS and not restless and not blind:
            return ""
        if now - began >= limit_ns:
            if blind:
                return "the cameras could not show that the robots stand still"
            return "; ".join(restless) + f" {limit_ns / SECOND:g} s after the stop"


def _speed_mm(rig: Rig, i: int, window: list[CameraFrame]) -> float:
    """Return how fast robot i moved between the first and the last frame that show it [mm/s]."""
    seen = [(f.sampled_ns, pose) for f in window if (pose := f.poses[i]) is not None]
    if len(seen) < 2 or seen[-1][0] == seen[0][0]:
        return 0.0
    (began, first), (ended, last) = seen[0], seen[-1]
    gone = math.hypot(last.x - first.x, last.y - first.y) * rig.mm
    return gone * SECOND / (ended - began)
