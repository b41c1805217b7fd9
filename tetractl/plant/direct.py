"""Simulates robots that receive the direction itself and turn to it by the paper's equation (3)."""

import numpy as np

from tetractl.core.clock import NEVER, SECOND
from tetractl.core.commands import FieldOff, Steer, Stop, Turn
from tetractl.core.poses import Bools, Floats, Poses, Times
from tetractl.experiment.disturbance import DelayedCommand
from tetractl.model.motion.motion import Held, Motion

LEAST_A = 1e-12
"""Turning rate of a robot that is held still [rad/s]; not 0, as the closed form divides by it."""


def aim(action: Steer | Turn | FieldOff, heading: Floats) -> Floats:
    """Return the direction [rad] towards which each robot turns: without a field, its heading."""
    match action:
        case Steer(u) | Turn(u):
            return np.full(heading.shape, u)
        case FieldOff():
            return heading


class DirectDrive:
    """Moves N robots with turning rates a [rad/s] and speeds [length unit/s], both (N,).

    Between two commands the motion is known in closed form, so the path is sampled, not integrated.
    """

    host = None  # robots are sent the direction itself
    sampled = False  # the path is known in closed form between samples too
    repeats_ns = NEVER  # a direction is held until the next one: it is not sent repeatedly
    rest_s = 0.0  # time from a stop until the robots stand [s]

    def __init__(self, motion: Motion, a: Floats, speed: Floats, starts: Poses) -> None:
        self.poses = starts
        self._motion = motion
        self._held = Held(*(np.zeros(a.size) for _ in range(4)))
        self._free = np.zeros(a.size, dtype=np.bool_)  # robots on which no field acts
        self._sine = np.zeros(a.size)  # sin(u - heading) when the command was received
        self._ahead = np.ones(a.size)  # 0 for robots that turn on the spot, 1 for others
        self.vary(a, speed)

    @property
    def commanded(self) -> Floats:
        """1 for robots whose last command moves them, 0 for others, (N,)."""
        return self._held.moving

    @property
    def moving(self) -> Floats:
        """1 for robots that move, 0 for robots that stand, (N,)."""
        return self.commanded * self._able

    def vary(self, a: Floats, speed: Floats) -> None:
        """Change the true turning rates a and speeds from now on, (N,) each."""
        self._able = (a > 0) | (speed > 0)
        self._a, self._speed = np.maximum(a, LEAST_A), speed
        self._held.turning = a * self._sine

    def advance(self, since_ns: int, times: Times, ticks: Bools) -> Floats:
        """Advance the robots; return x, y, heading (M, 3, N) at the `times` (M,) [ns].

        `ticks` (M,), True at times at which the true path is sampled, is not used.
        """
        p, held = self.poses, self._held
        t = ((times - since_ns) / SECOND)[:, None] * self.moving
        if self._free.any():  # a robot without field does not turn: its u is its heading
            held.direction = np.where(self._free, p.heading, held.direction)
        path = self._motion.hold(p.x, p.y, p.heading, held, self._a, self._ahead * self._speed, t)
        self.poses = Poses(*(each[-1] for each in path))
        return np.concatenate(path, axis=1).reshape(times.size, 3, -1)

    def apply(self, command: DelayedCommand) -> None:
        """Apply a command to the robots that received it.

        With the motion `arc`, wheel speeds are computed from the headings that were measured when
        the command was sent; with `euler`, the chords begin at the true headings.
        """
        got, held, action = command.reached, self._held, command.action
        heading = self.poses.heading
        held.moving[got] = not isinstance(action, Stop)
        held.course[got] = heading[got]
        self._ahead[got] = not isinstance(action, Turn)
        self._free[got] = isinstance(action, FieldOff)
        self._sine[got] = 0.0
        if isinstance(action, Steer | Turn):
            u, answered = aim(action, heading), heading
            if self._motion.name == "arc" and command.headings is not None:
                answered = command.headings
            self._sine[got] = np.sin(u - answered)[got]
            held.direction[got] = u[got]
        held.turning = self._a * self._sine
