"""Which robots move while all should stand, by the camera's frames of a rest.

Robots that were stopped may move all the same: a motor creeps, or the floor slopes. A controller
that rests to measure them measures where they are no longer, and rests again. In a lab the guard
looks at this, too; here it is for every plant. Of the last LOOK_S of a rest, the mean place in the
first half is compared with that in the second.
"""

from collections.abc import Sequence

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.commands import Stop
from tetractl.core.plan import Plan
from tetractl.core.poses import Floats, Observation
from tetractl.core.setup import Setup

LOOK_S = 0.15
"""Time at the end of a rest that is examined [s]. Before, a robot that missed the stop drives on
until its watchdog stops it: 0.25 s and a dead time, of a rest of 0.55 s."""
LEAST_FRAMES = 6
"""Least number of frames of that time."""
LEAST_SHARE = 0.05
"""Least speed that is said, as a fraction of the robot's."""
SURE_STDS = 5.0
"""Least way that is said, in standard deviations of the difference of two mean places."""


def speeds_at_rest(frames: Sequence[Observation]) -> Floats:
    """Return how fast robots (N,) surely moved at the end of some frames [length unit/s], 0 if they
    stood, or if there are too few frames."""
    robots = len(frames[-1].valid)
    from_ns = frames[-1].sampled_ns - round(LOOK_S * SECOND)
    last = [frame for frame in frames if frame.sampled_ns >= from_ns and frame.valid.all()]
    if len(last) < LEAST_FRAMES:
        return np.zeros(robots)
    half = len(last) // 2
    places = np.array([frame.poses.xy for frame in last])  # (F, N, 2)
    times_s = np.array([frame.seconds for frame in last])
    first = places[:half]
    second = places[half:]
    way = np.hypot(*(second.mean(axis=0) - first.mean(axis=0)).T)
    variance = first.var(axis=0, ddof=1) / len(first) + second.var(axis=0, ddof=1) / len(second)
    is_sure = way > SURE_STDS * np.sqrt(variance.sum(axis=1))
    seconds = times_s[half:].mean() - times_s[:half].mean()
    return np.where(is_sure, way / seconds, 0.0)


class RestNews:
    """Says of each robot, once a trial, that it moves though all should stand."""

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self._said: set[str] = set()

    def of(self, plan: Plan, frames: Sequence[Observation]) -> list[str]:
        """Return what is news of the frames since the command of a plan was sent."""
        if not isinstance(plan.instead, Stop):
            return []
        speeds = speeds_at_rest(frames)
        texts: list[str] = []
        for i, name in enumerate(self._setup.names):
            if speeds[i] > LEAST_SHARE * self._setup.speed[i] and name not in self._said:
                self._said.add(name)
                speed = f"{speeds[i]:.2g} {self._setup.unit}/s"
                texts.append(f"{name} moves by {speed} while it should stand")
        return texts
