"""Warnings about robots that move while they should stand still.

A stopped robot may still move: a motor creeps, or the floor slopes. A controller that stops the
robots in order to measure their poses then measures places that they have already left, and stops
them again. The guard of a lab checks this as well; this check works on every plant. In the last
WINDOW_S of a stop, it compares the mean positions of the first and of the second half.
"""

from collections.abc import Sequence

import numpy as np

from tetractl.core import elementwise
from tetractl.core.clock import SECOND
from tetractl.core.commands import Stop
from tetractl.core.plan import Plan
from tetractl.core.poses import Floats, Observation
from tetractl.core.setup import Setup

WINDOW_S = 0.15
"""Time at the end of a stop that is examined [s]. Before it, a robot that missed the stop may
still drive until its watchdog stops it. That takes 0.25 s and a dead time, out of 0.55 s."""
FRAMES_MIN = 6
"""Minimum number of frames in the window. With fewer frames, no motion is reported."""
SPEED_FRACTION_MIN = 0.05
"""Minimum speed that is reported, as a fraction of the robot's own speed."""
DISTANCE_STDS = 5.0
"""Minimum distance that counts as motion, in standard deviations of the means' difference."""


def speeds_at_rest(frames: Sequence[Observation]) -> Floats:
    """Estimate how fast each robot moved at the end of some frames.

    Args:
        frames: Successive frames of all robots, the oldest first. At least one.

    Returns:
        Speeds, shape (N,) [length unit/s]. 0 if the motion is not significant, or if fewer than
        FRAMES_MIN frames of the window show all robots.
    """
    n_robots = len(frames[-1].valid)
    window_start_ns = frames[-1].sampled_ns - round(WINDOW_S * SECOND)
    window = [
        frame for frame in frames if frame.sampled_ns >= window_start_ns and frame.valid.all()
    ]
    if len(window) < FRAMES_MIN:
        return np.zeros(n_robots)
    half_count = len(window) // 2
    positions = np.array([frame.poses.xy for frame in window])  # (F, N, 2)
    times_s = np.array([frame.seconds for frame in window])
    first_half = positions[:half_count]
    second_half = positions[half_count:]
    distances = elementwise.hypot(*(second_half.mean(axis=0) - first_half.mean(axis=0)).T)
    variance = first_half.var(axis=0, ddof=1) / len(first_half)
    variance += second_half.var(axis=0, ddof=1) / len(second_half)
    is_significant = distances > DISTANCE_STDS * np.sqrt(variance.sum(axis=1))
    elapsed_s = times_s[half_count:].mean() - times_s[:half_count].mean()
    return np.where(is_significant, distances / elapsed_s, 0.0)


class RestMonitor:
    """Reports robots that move although they were commanded to stop, each once in a trial."""

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self._reported: set[str] = set()

    def warnings(self, plan: Plan, frames: Sequence[Observation]) -> list[str]:
        """Return a warning for each robot that moves during a stop and was not reported yet.

        Args:
            plan: The plan that was carried out. There are no warnings unless it sent a stop.
            frames: The frames since the plan's command was sent, the oldest first.
        """
        if not isinstance(plan.instead, Stop):
            return []
        speeds = speeds_at_rest(frames)
        warnings = list[str]()
        for i, name in enumerate(self._setup.names):
            is_moving = speeds[i] > SPEED_FRACTION_MIN * self._setup.speed[i]
            if is_moving and name not in self._reported:
                self._reported.add(name)
                speed = f"{speeds[i]:.2g} {self._setup.unit}/s"
                warnings.append(f"{name} moves by {speed} although it should stand still")
        return warnings
