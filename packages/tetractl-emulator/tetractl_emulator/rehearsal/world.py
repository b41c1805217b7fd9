"""The world of a day: noise and latency of the camera, and robots, radio and starts that differ
from the spec.

Most days stay within what the spec's limits allow; on some a robot is put too far from its start,
or a wheel is off by more than `wheel_error`, and then a reason may name that.
"""

import math
from random import Random
from typing import Any

from tetractl.core.setup import Setup
from tetractl_emulator.rehearsal.participants import LabRehearsal
from tetractl_emulator.rehearsal.schedule import PLACE

LAG_MAX_S = 0.08
"""Longest time constant of a wheel that is drawn [s]."""
FAR = r"from its start|turned by"
"""Reasons that are right if a robot is far from its start."""
OFF = r"off its commanded|moves |turns "
"""Reasons that are right if a wheel is off."""
FAR_SHARE = 0.02
"""Share of the days with a robot too far from its start."""
OFF_SHARE = 0.02
"""Share of the days with a wheel too far off."""


def world_of_day(
    random: Random, setup: Setup, lab: LabRehearsal, bad: bool = True
) -> tuple[dict[str, Any], str]:
    """Draw a world for a lab, as its spec allows if it is not `bad`; return the section `emulation`
    of a day's script, and a regular expression of the reasons that are right without a fault.
    """
    camera = lab.camera(random, 0.0)
    far = random.random() < FAR_SHARE and bad
    off = random.random() < OFF_SHARE and bad
    right = [PLACE]
    if far:
        right.append(FAR)
    if off:
        right.append(OFF)
    emulation: dict[str, Any] = {"camera": camera}
    if lab.placed:
        far_mm = 1.6 * lab.start_mm if far else 0.0
        emulation["robots"] = _placed(random, setup, far_mm, 0.16 * lab.start_mm)
    slower = random.uniform(0.17, 0.3) if off else 0.0
    emulation["actuator"] = lab.actuator(random, slower)
    return emulation, "|".join(right)


def _placed(random: Random, setup: Setup, far_mm: float, near_mm: float) -> list[dict[str, Any]]:
    """Return starts that are off by up to `near_mm`, the first by `far_mm` unless that is 0."""
    placed = []
    for i, name in enumerate(setup.names):
        off = (far_mm if far_mm and i == 0 else random.uniform(0, near_mm)) / 1000 / setup.metres
        angle = random.uniform(-math.pi, math.pi)
        x = float(setup.starts.x[i] + off * math.cos(angle))
        y = float(setup.starts.y[i] + off * math.sin(angle))
        heading = round(float(setup.starts.heading[i]) + random.uniform(-0.05, 0.05), 4)
        start = [round(x, 2), round(y, 2)]
        placed.append({"name": name, "start": start, "heading": heading})
    return placed
