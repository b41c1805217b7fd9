"""Simulates cells that swim on a helix under a field, between walls; see `model.swimmers`."""

import math

import numpy as np

from tetractl.core.clock import NEVER
from tetractl.core.commands import Steer, Stop
from tetractl.core.poses import Bools, Floats, Poses, Times
from tetractl.core.setup import Setup
from tetractl.experiment.base import Model, NonNegative
from tetractl.experiment.disturbance import DelayedCommand
from tetractl.model.motion.swimming import FIELD, GOING, HELIX, PHASE, SPEED, A, steps_until
from tetractl.model.swimmers import DIPOLE_SD_RAD, DRIFT_UM_S, Swimmers, to_the_left, walls_of


class CultureSection(Model):
    """Simulates the robots as swimming cells with the spec's turning rates and speeds; their other
    properties are drawn at random, see docs/explanation/cells.md. Cells turn by the paper's
    equation (3), and `heading_noise` is the random walk of their heading.
    """

    dipole: NonNegative = DIPOLE_SD_RAD
    """Standard deviation of the dipole's angle from a cell's axis [rad]."""
    drift: NonNegative = DRIFT_UM_S
    """Speed of the medium's flow [um/s]; its direction is drawn once per trial."""
    walls: bool = True
    """Whether the arena's edges are walls, along which cells slide."""


class CellDrive:
    """Moves N cells. As measured by the `cells` camera, a pose is the centre of the body and the
    heading of the helix.

    Simulated cells do not swim before the first command or after a stop, so that a trial ends with
    the poses at the stop; real cells swim on.
    """

    host = None  # no host computes wheel speeds
    sampled = True  # the path is integrated in time steps, not known in closed form
    repeats_ns = NEVER  # a field holds until the next command
    rest_s = 0.0

    def __init__(
        self,
        section: CultureSection,
        setup: Setup,
        a: Floats,
        speed: Floats,
        starts: Poses,
        walk: float,
        random: np.random.Generator,
    ) -> None:
        from tetractl.plant.swim_kernel import swim

        count, self._swim, self.random = len(setup.names), swim, random
        cells, self.unit_um = Swimmers.drawn(random, count), setup.metres * 1e6
        cells.bias, cells.walk = random.normal(0, section.dipole, count), np.full(count, walk)
        towards = random.uniform(-math.pi, math.pi)
        drift = section.drift * math.cos(towards), section.drift * math.sin(towards)
        rim_um = float(cells.helix_um.max())
        cells.resting[:] = True
        walls = walls_of(setup, rim_um) if section.walls else None
        self._body = cells.laid_out(drift=drift, walls=walls)
        self.vary(a, speed)
        self.poses = starts

    @property
    def poses(self) -> Poses:
        """The present poses of the bodies."""
        return self._poses

    @poses.setter
    def poses(self, poses: Poses) -> None:
        self._poses, self._placed = poses, True

    @property
    def body(self) -> Floats:
        """The cells, (ROWS, N) of `model.motion.swimming`."""
        body, poses = self._body, self._poses
        if self._placed:
            across = body[HELIX] * np.cos(body[PHASE])
            x, y = to_the_left(poses.heading, across)
            body[0], body[1] = poses.x * self.unit_um - x, poses.y * self.unit_um - y
            body[2], self._placed = poses.heading, False
        return body

    @property
    def moving(self) -> Floats:
        """1 for cells whose last command lets them swim, 0 for others, (N,)."""
        return self._body[GOING].copy()

    commanded = moving

    def vary(self, a: Floats, speed: Floats) -> None:
        """Change the true turning rates a and speeds from now on, (N,) each."""
        self._body[A], self._body[SPEED] = a, speed * self.unit_um

    def advance(self, since_ns: int, times: Times, ticks: Bools) -> Floats:
        """Advance the cells; return x, y, heading (M, 3, N) at the `times` (M,) [ns].

        `ticks` (M,), True at times at which the true path is sampled, is not used.
        """
        steps, count = steps_until(since_ns, times.tolist()), self._body.shape[1]
        noise = self.random.standard_normal((steps, 2, count))
        path = np.empty((times.size, 3, count))
        self._swim(self.body, since_ns, times, noise, self.unit_um, path)
        self._poses = Poses(*path[-1].copy())
        return path

    def apply(self, command: DelayedCommand) -> None:
        """Apply a command to the cells that it reaches."""
        got, body, action = command.reached, self._body, command.action
        body[GOING, got] = not isinstance(action, Stop)
        field = 0.0, 0.0
        if isinstance(action, Steer):
            field = math.cos(action.direction), math.sin(action.direction)
        body[FIELD, got], body[FIELD + 1, got] = field
