"""Classes of faults that no camera can show: what they break is predicted, and is no alarm.

A class is one of a whole day: a violation has it if such a fault became visible on that day, at any
time and of any robot. Whether this fault caused the violation is not checked.
"""

import math

from tetractl_emulator.rehearsal.schedule import FRAME_S
from tetractl_emulator.rehearsal.truth import Truth, VisibleFault

SLOW = "slow: as wheels within wheel_error"
BEFORE = "before: the camera was off when the run began"
FROZEN = "frozen: as robots that stand"
"""The classes, by their first words those of docs/rehearsals.md."""
NOISE_MM_S = 5.0
"""Speed that counts as slow though wheels are perfect, since poses have noise; a choice."""
SCALED_MM = 1000.0
"""Distance from the origin at which a change of scale counts as motion; a choice."""
WHEEL_RADIUS = 0.04
"""Distance from a wheel to the centre of robots whose spec has no wheels [length unit], in metres
that of an m3pi."""


def undetectable_motion(truth: Truth) -> str:
    """Return the class of false motion on the day that a camera cannot distinguish from true
    motion: `SLOW` or `BEFORE`, that of the first such fault; "" for none.

    A ghost, or a picture that creeps, is slow if wheels that are off by `wheel_error` could move a
    robot as fast. A picture that stopped creeping before the run began is of `BEFORE`: all poses of
    the run are measured in it.
    """
    for fault in truth.faults_of("ghost", "picture"):
        is_picture = fault.name == "picture"
        if is_picture and not fault.fields.get("creeps"):
            continue
        if _is_slow(truth, fault):
            return SLOW
        if is_picture and fault.span.ended_s <= truth.began_s:
            return BEFORE
    return ""


def _is_slow(truth: Truth, fault: VisibleFault) -> bool:
    """Return whether wheels within `wheel_error` move the fastest robot as a fault moves poses in
    each frame: by `by`, and by a `scale` that grows, with the noise of poses; by a `turn`, as two
    wheels that are off in opposite directions.
    """
    setup = truth.setup
    speed_mm_s = float(setup.speed.max()) * setup.metres * 1000
    wheel_radius_mm = (setup.wheel_radius or WHEEL_RADIUS) * setup.metres * 1000
    wheel_off_mm_s = truth.limits.wheel_error * speed_mm_s
    slow_mm_s = wheel_off_mm_s + NOISE_MM_S
    fields = fault.fields
    moves_mm_s = math.hypot(*fields.get("by", (0.0, 0.0))) / FRAME_S
    grows_mm_s = abs(fields.get("scale", 1.0) - 1.0) / FRAME_S * SCALED_MM
    turns_rad_s = abs(fields.get("turn", 0.0)) / FRAME_S
    is_slow_turn = turns_rad_s <= wheel_off_mm_s / wheel_radius_mm
    return is_slow_turn and moves_mm_s <= slow_mm_s and grows_mm_s <= slow_mm_s


def undetectable_freeze(truth: Truth) -> str:
    """Return the class `FROZEN` on a day on which poses or frames were repeated by a camera that
    measures on a grid, of which robots that stand have equal poses, too; "" otherwise. Whether
    robots stood is not checked.
    """
    is_repeated = truth.setup.sight.coarse and truth.met("repeat", "freeze")
    return FROZEN if is_repeated else ""
