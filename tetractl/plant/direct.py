"""Simulate robots that receive the direction itself and turn to it by the paper's equation (3)."""

import numpy as np

from tetractl.core import elementwise
from tetractl.core.clock import SECOND
from tetractl.core.commands import FieldOff, Steer, Stop, Turn
from tetractl.core.poses import Bools, Floats, Poses, Times
from tetractl.model.motion.motion import Held, Motion
from tetractl.spec.disturbance import DelayedCommand

A_MIN_RAD_S = 1e-12
"""Minimum turning rate a in the equations [rad/s], which divide by a."""


def find_aimed_directions(action: Steer | Turn | FieldOff, heading: Floats) -> Floats:
    """Find the direction to which each robot turns [rad], shape (N,).

    Without a field, the direction is the robot's own heading, so the robot does not turn.
    """
    match action:
        case Steer(u) | Turn(u):
            return np.full(heading.shape, u)
        case FieldOff():
            return heading


class DirectDrive:
    """The motion of N robots that follow the direction itself, without wheels; a `Drive`.

    Between two commands the motion is known in closed form, so the path is sampled, not integrated.

    Args:
        motion: The model of motion.
        a: Turning rates [rad/s], shape (N,).
        speed: Speeds [length unit/s], shape (N,).
        starts: Poses at the start.
    """

    host = None  # robots receive the direction itself
    is_integrated = False  # the path is known in closed form between samples
    stopping_s = 0.0  # robots stand still as soon as they are stopped

    def __init__(self, motion: Motion, a: Floats, speed: Floats, starts: Poses) -> None:
        n_robots = a.size
        self.poses = starts
        self.gains = np.ones((2, n_robots))  # no wheels
        self._motion = motion
        self.held_commands = Held(
            direction=np.zeros(n_robots),
            turning=np.zeros(n_robots),
            course=np.zeros(n_robots),
            moving=np.zeros(n_robots),
        )
        """The commands that the robots follow at present."""
        self._sine = np.zeros(n_robots)  # sin(u - heading) when the command was received
        self._has_no_field = np.zeros(n_robots, dtype=np.bool_)
        self._turns_on_spot = np.zeros(
            n_robots, dtype=np.bool_
        )  # whether robots turn without driving
        self.vary(a, speed)

    @property
    def commanded(self) -> Floats:
        """1 for each robot whose last command makes it move, 0 for the others, shape (N,)."""
        return self.held_commands.moving

    @property
    def moving(self) -> Floats:
        """1 for each robot that moves, 0 for each robot that stands still, shape (N,)."""
        return np.where(self._is_able, self.held_commands.moving, 0.0)

    def vary(self, a: Floats, speed: Floats) -> None:
        """Change the true turning rates a [rad/s] and speeds [length unit/s], shape (N,), now.

        A robot with a = 0 and speed 0 stands still.
        """
        self._is_able = (a > 0) | (speed > 0)
        self._a = np.maximum(a, A_MIN_RAD_S)
        self._speed = speed
        self.held_commands.turning = a * self._sine

    def advance(self, since_ns: int, times_ns: Times, samples: Bools) -> Floats:
        """Move the robots, and return x, y and heading (M, 3, N); see `Drive.advance`."""
        start_poses = self.poses
        held_commands = self.held_commands
        # a robot that stands still moves for no time
        seconds = ((times_ns - since_ns) / SECOND)[:, None] * self.moving
        if self._has_no_field.any():  # the direction is the robot's heading
            held_commands.direction = np.where(
                self._has_no_field, start_poses.heading, held_commands.direction
            )
        speed = np.where(self._turns_on_spot, 0.0, self._speed)
        path = self._motion.hold(
            start_poses.x,
            start_poses.y,
            start_poses.heading,
            held_commands,
            self._a,
            speed,
            seconds,
        )
        x, y, heading = path
        self.poses = Poses(x[-1], y[-1], heading[-1])
        return np.concatenate(path, axis=1).reshape(times_ns.size, 3, -1)

    def apply(self, command: DelayedCommand) -> None:
        """Apply a command to the robots that received it.

        With the motion `euler`, robots drive straight from the headings that they have now.
        """
        reached = command.reached
        held_commands = self.held_commands
        action = command.action
        heading = self.poses.heading
        held_commands.moving[reached] = 0.0 if isinstance(action, Stop) else 1.0
        held_commands.course[reached] = heading[reached]
        self._turns_on_spot[reached] = isinstance(action, Turn)
        self._has_no_field[reached] = isinstance(action, FieldOff)
        self._sine[reached] = 0.0
        if isinstance(action, Steer | Turn):
            direction = find_aimed_directions(action, heading)
            self._sine[reached] = elementwise.sin(direction - heading)[reached]
            held_commands.direction[reached] = direction[reached]
        held_commands.turning = self._a * self._sine
