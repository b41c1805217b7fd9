"""Predict robots whose motion is known exactly, over the dead time of their commands.

Since nothing has to be identified, nothing is filtered. Each pose is taken as the camera measured
it, and is advanced along the directions that were sent, by the closed form of the paper's equations
(1)-(3) (`model.motion`). The class has the methods of
`tetractl.control.estimation.filter.FilterBank`, which is used if the motion has to be identified.
"""

import math
from bisect import bisect_right
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tetractl.control.estimation.prior import Prior
from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, FieldOff
from tetractl.core.poses import Floats, Observation, Poses
from tetractl.model.motion import exact

NEVER_NS = 2**62
"""A time later than every command [ns]."""


class KnownForecast(NamedTuple):
    """The predicted poses of N robots at the moment when the next command acts on them.

    Attributes:
        poses: Their poses.
        directions: The directions that they follow then [rad], shape (N,). NaN for a robot that
            stands still.
        dead_time_s: The dead time of the prior [s].
    """

    poses: Poses
    directions: Floats
    dead_time_s: float


class KnownMotion:
    """Predicts N robots whose motion is known exactly, without filtering.

    Add frames and commands in the order in which they become known. Every robot is assumed to
    receive every command, one dead time after it was sent.
    """

    def __init__(self, prior: Prior) -> None:
        self._prior = prior
        self._dead_time_ns = round(prior.dead_time * SECOND)
        self._last_frame: Observation | None = None
        self._acts_ns = list[int]()
        self._directions = list[float]()

    def add_frames(self, newest: Observation, earlier: Sequence[Observation] = ()) -> None:
        """Take the poses of the newest frame of a control step. Earlier frames are ignored."""
        self._last_frame = newest

    def add_command(self, command: Command) -> None:
        """Record a command, which takes effect one dead time after it was sent.

        If the command has no direction, the robots stand still. Switching the field off is
        ignored.
        """
        if isinstance(command.action, FieldOff):
            return  # it turns no robot
        direction = math.nan if command.direction is None else command.direction
        self._acts_ns.append(command.sent_ns + self._dead_time_ns)
        self._directions.append(direction)

    def restart(self, robots: Sequence[int]) -> None:
        """Do nothing, because the next frame contains the poses of replaced robots."""

    def forecast(self, sent_ns: int) -> KnownForecast:
        """Predict the robots to the moment when a command sent at `sent_ns` [ns] acts on them.

        If that moment is before the newest frame, the result is the poses of this frame.
        """
        frame = self._last_frame
        assert frame is not None, "poses are predicted from those of a frame"
        n_robots = len(frame.valid)
        begin_ns = np.array(frame.exposed_ns or (frame.sampled_ns,) * n_robots)
        end_ns = np.maximum(sent_ns + self._dead_time_ns, begin_ns)
        x, y, heading = frame.poses.x, frame.poses.y, frame.poses.heading
        directions = np.full(n_robots, np.nan)
        first_index = max(bisect_right(self._acts_ns, int(begin_ns.min())) - 1, 0)
        until_ns = [*self._acts_ns[first_index + 1 :], NEVER_NS]
        for k, direction in enumerate(self._directions[first_index:]):
            acts_ns = self._acts_ns[first_index + k]
            directions[acts_ns <= end_ns] = direction
            followed_ns = np.minimum(until_ns[k], end_ns) - np.maximum(acts_ns, begin_ns)
            if math.isnan(direction) or not (followed_ns > 0).any():
                continue
            seconds = np.maximum(followed_ns, 0) / SECOND
            directions_now = np.full(n_robots, direction)
            x, y, heading = exact.step(
                x, y, heading, directions_now, self._prior.a, self._prior.speed, seconds
            )
        return KnownForecast(Poses(x, y, heading), directions, self._prior.dead_time)
