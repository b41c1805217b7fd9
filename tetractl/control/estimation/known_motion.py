"""Predicts robots whose motion is known over the dead time.

Nothing is identified, so there is nothing to filter: each pose is taken as the camera measured it,
and is advanced by the closed form of (1)-(3) along the directions that were sent (`model.motion`).
It has the methods of `tetractl.control.estimation.filter.FilterBank`, which identifies the motion.
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
"""A time after every command [ns]."""


class KnownForecast(NamedTuple):
    """The N robots at the moment when the next command acts on them.

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
    """Predicts N robots of which everything is known.

    Frames and commands are added in the order in which they become known. All robots receive every
    command, one dead time after it was sent.
    """

    def __init__(self, prior: Prior) -> None:
        self._prior = prior
        self._dead_time_ns = round(prior.dead_time * SECOND)
        self._last_frame: Observation | None = None
        self._acts_ns = list[int]()
        self._directions = list[float]()

    def add_frames(self, newest: Observation, earlier: Sequence[Observation] = ()) -> None:
        """Take the poses of the newest frame of a control step."""
        self._last_frame = newest

    def add_command(self, command: Command) -> None:
        """Add a command with the time at which it was sent. Robots stand if it has no direction."""
        if isinstance(command.action, FieldOff):
            return  # it turns no robot
        direction = math.nan if command.direction is None else command.direction
        self._acts_ns.append(command.sent_ns + self._dead_time_ns)
        self._directions.append(direction)

    def restart(self, robots: Sequence[int]) -> None:
        """Nothing is to be forgotten about replaced robots: their poses come from the frame."""

    def forecast(self, sent_ns: int) -> KnownForecast:
        """Predict the robots until a command that is sent at `sent_ns` [ns] acts on them."""
        frame = self._last_frame
        assert frame is not None, "poses are predicted from those of a frame"
        count = len(frame.valid)
        begin_ns = np.array(frame.exposed_ns or (frame.sampled_ns,) * count)
        end_ns = np.maximum(sent_ns + self._dead_time_ns, begin_ns)
        x, y, heading = frame.poses.x, frame.poses.y, frame.poses.heading
        directions = np.full(count, np.nan)
        first = max(bisect_right(self._acts_ns, int(begin_ns.min())) - 1, 0)
        until_ns = [*self._acts_ns[first + 1 :], NEVER_NS]
        for c, direction in enumerate(self._directions[first:]):
            acts_ns = self._acts_ns[first + c]
            directions[acts_ns <= end_ns] = direction
            followed_ns = np.minimum(until_ns[c], end_ns) - np.maximum(acts_ns, begin_ns)
            if math.isnan(direction) or not (followed_ns > 0).any():
                continue
            seconds = np.maximum(followed_ns, 0) / SECOND
            u = np.full(count, direction)
            x, y, heading = exact.step(x, y, heading, u, self._prior.a, self._prior.speed, seconds)
        return KnownForecast(Poses(x, y, heading), directions, self._prior.dead_time)
