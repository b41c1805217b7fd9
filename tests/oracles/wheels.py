"""Robots on wheels in arrays, to be read: what `tetractl.model.motion.rolling` computes."""

import math
from dataclasses import dataclass

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.poses import Floats
from tetractl.model.wheels import Drivetrains


def counts(trains: Drivetrains, speeds: Floats, owed: Floats) -> tuple[Floats, Floats]:
    """Return the counts (2, N) in the order of the wheels, and the rounding errors owed (2, N)."""
    span = trains.limit - trains.dead_zone
    scale = 1.0 / np.maximum(1.0, (np.abs(speeds / trains.gain) / span).max(axis=0))
    total = speeds * scale / trains.gain + owed  # of a wheel of speed 0: rounds to 0
    steps = np.rint(np.clip(total, -span, span))
    owed = np.clip(total - steps, -0.5, 0.5) * speeds.any(axis=0)
    return steps + np.sign(steps) * trains.dead_zone, owed


@dataclass
class LaggingTurns:
    """The headings of N robots whose wheels follow turning rates `sent` [rad/s], (N,) each with the
    time [ns] from which it acts, with the lag `lag_s` [s]."""

    lag_s: float
    sent: list[tuple[int, Floats]]

    def ahead(self, heading: Floats, since: int, until: int) -> Floats:
        """Return the headings in which robots come to rest if they stop at `until` [ns]; `heading`
        (N,) are their headings at `since` [ns]."""
        turning = np.zeros_like(heading)
        ends = [*(begin for begin, _ in self.sent[1:]), until]
        for (begin, rate), end in zip(self.sent, ends, strict=True):
            acted = max(min(end, since) - begin, 0) / SECOND
            turning = rate + (turning - rate) * math.exp(-acted / self.lag_s)
            heading = heading + rate * (max(end - max(begin, since), 0) / SECOND)
        return heading + self.lag_s * turning


def path(
    pose: Floats, wheels: Floats, targets: Floats, radius: Floats, lag_s: float, seconds: Floats
) -> tuple[Floats, Floats]:
    """Return x, y, heading (3, M, N) at times `seconds` (M,) after `pose` (3, N) and the last wheel
    speeds (2, N), for wheels that follow `targets` (2, N) from the speeds `wheels` (2, N)."""
    share = 1 - np.exp(-seconds[:, None] / lag_s)  # (M, 1)
    left, right = (
        target * seconds[:, None] + lag_s * (wheel - target) * share
        for wheel, target in zip(wheels, targets, strict=True)
    )
    turned = np.vstack([0 * radius, (right - left) / (2 * radius)])
    way = np.diff(np.vstack([0 * radius, (right + left) / 2]), axis=0)
    half = np.diff(turned, axis=0) / 2
    course = pose[2] + turned[:-1] + half
    chord = way * np.sinc(half / np.pi)
    x, y = np.cumsum(chord * np.cos(course), axis=0), np.cumsum(chord * np.sin(course), axis=0)
    end = targets + (wheels - targets) * (1 - share[-1])
    return np.array([pose[0] + x, pose[1] + y, pose[2] + turned[1:]]), end
