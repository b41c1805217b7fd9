"""Simulates cells that swim on a helix under a field, between walls; see `model.swimmers`."""

import math

import numpy as np

from tetractl.core.clock import NEVER, SECOND
from tetractl.core.commands import Steer, Stop
from tetractl.core.poses import Bools, Floats, Poses, Times
from tetractl.core.setup import Setup
from tetractl.experiment.base import Model, NonNegative
from tetractl.experiment.disturbance import DelayedCommand
from tetractl.model.motion.swimming import steps_until
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
        from tetractl.control.kernels.swimming import swim

        count, self._um, self._random = len(setup.names), setup.metres * 1e6, random
        self._swim, self.cells = swim, Swimmers.drawn(random, count)
        cells = self.cells
        cells.bias, cells.walk = random.normal(0, section.dipole, count), np.full(count, walk)
        towards = random.uniform(-math.pi, math.pi)
        self._drift = section.drift * math.cos(towards), section.drift * math.sin(towards)
        self._field = np.zeros((2, count))
        self._laid_out: Floats | None = None  # the cells' constants, under the present field
        # 1 for cells whose last command lets them swim, 0 for others
        self.commanded = self.moving = np.zeros(count)
        rim_um = float(cells.helix_um.max())
        self._walls = walls_of(setup, rim_um) if section.walls else None
        cells.resting[:] = True
        # the cells' arrays are its rows
        self._state = np.array([cells.x, cells.y, cells.heading, cells.phase, cells.depth])
        cells.x, cells.y, cells.heading, cells.phase, cells.depth = self._state
        self.vary(a, speed)
        self._across = cells.helix_um * np.cos(cells.phase)  # from the helix's axis to the body
        self.poses = starts

    @property
    def poses(self) -> Poses:
        """The present poses of the bodies."""
        return self._poses

    @poses.setter
    def poses(self, poses: Poses) -> None:
        cells, um = self.cells, self._um
        cells.heading[:], (x, y) = poses.heading, to_the_left(poses.heading, self._across)
        cells.x += poses.x * um - (cells.x + x)
        cells.y += poses.y * um - (cells.y + y)
        self._poses = Poses((cells.x + x) / um, (cells.y + y) / um, poses.heading)

    def vary(self, a: Floats, speed: Floats) -> None:
        """Change the true turning rates a and speeds from now on, (N,) each."""
        self.cells.a, self.cells.speed, self._laid_out = a.copy(), speed * self._um, None

    def advance(self, since_ns: int, times: Times, ticks: Bools) -> Floats:
        """Advance the cells; return x, y, heading (M, 3, N) at the `times` (M,) [ns].

        `ticks` (M,), True at times at which the true path is sampled, is not used.
        """
        cells, um, seconds = self.cells, self._um, (times - since_ns) / SECOND
        if self._laid_out is None:
            self._laid_out = cells.laid_out(
                (self._field[0], self._field[1]), self._drift, self._walls
            )
        noise = self._random.standard_normal((steps_until(seconds.tolist()), 2, len(cells)))
        x, y, heading, phase = self._swim(self._state, self._laid_out, seconds, noise)
        across = cells.helix_um * np.cos(phase)
        left = to_the_left(heading, across)
        x, y, self._across = (x + left[0]) / um, (y + left[1]) / um, across[-1]
        self._poses = Poses(x[-1], y[-1], heading[-1])
        return np.stack((x, y, heading), axis=1)

    def apply(self, command: DelayedCommand) -> None:
        """Apply a command to the cells that it reaches."""
        got: Bools = command.reached
        self.cells.resting[got] = isinstance(command.action, Stop)
        self.commanded = self.moving = (~self.cells.resting).astype(np.float64)
        new = (0.0, 0.0)
        if isinstance(command.action, Steer):
            new = math.cos(command.action.direction), math.sin(command.action.direction)
        self._field = np.where(got, np.array(new)[:, None], self._field)
        self._laid_out = None
