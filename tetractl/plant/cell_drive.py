"""Move simulated cells, which swim on a helix while a common field turns them.

`model.swimmers` models a cell: its axis follows the paper's equations (1)-(3), and its body circles
about the axis. A camera measures the body, so the poses here describe the body: its centre, and the
direction of the axis. Poses are in the spec's length unit, and the arrays of cells in micrometres.
"""

import math

import numpy as np

from tetractl.core import elementwise
from tetractl.core.commands import Steer, Stop
from tetractl.core.elementary import cos, sin
from tetractl.core.poses import Bools, Floats, Poses, Times
from tetractl.core.setup import Setup
from tetractl.model.motion.swimming import CellArrays, steps_until
from tetractl.model.swimmers import Swimmers, compute_walls_um, offset_to_left
from tetractl.plant.random_streams import RandomStream, generator
from tetractl.plant.sim_section import CultureSection
from tetractl.spec.disturbance import DelayedCommand


class CellDrive:
    """The motion of N simulated cells, a `Drive`.

    Simulated cells do not swim before the first command or after a stop, so that a trial ends with
    the poses at the stop. Real cells swim on.

    Args:
        section: The fields of the culture in the spec. Properties without a field are sampled.
        setup: The constants of the experiment.
        a: Turning rates [rad/s], shape (N,).
        speed: Speeds [length unit/s], shape (N,).
        starts: Poses at the start.
        heading_noise: Random walk of the headings [rad/sqrt(s)].
        seed: Determines everything random.
    """

    host = None  # no host computes wheel speeds
    is_integrated = True  # from sample to sample
    stopping_s = 0.0  # a cell stands as soon as it is stopped

    def __init__(
        self,
        section: CultureSection,
        setup: Setup,
        a: Floats,
        speed: Floats,
        starts: Poses,
        heading_noise: float,
        seed: np.random.SeedSequence,
    ) -> None:
        from tetractl.plant.drive_kernels import swim  # late: reading a spec needs no kernel

        self._swim = swim
        self._random = generator(seed, RandomStream.BODIES)
        self._um_per_unit = setup.metres * 1e6
        self.cells = self._sample_cells(section, setup, heading_noise)
        self.gains = np.ones((2, a.size))  # no wheels
        self.vary(a, speed)
        self.poses = starts

    def _sample_cells(
        self, section: CultureSection, setup: Setup, heading_noise: float
    ) -> CellArrays:
        """Sample the cells' properties that are not in the spec. All cells rest at first.

        The order of sampling determines the result, so it must not change.
        """
        n_cells = len(setup.names)
        cells = Swimmers.drawn(self._random, n_cells)
        cells.bias = self._random.normal(0, section.dipole, n_cells)
        cells.walk = np.full(n_cells, heading_noise)
        cells.resting[:] = True
        flow_direction = self._random.uniform(-math.pi, math.pi)
        flow_x_um_s = section.drift * cos(flow_direction)
        flow_y_um_s = section.drift * sin(flow_direction)
        walls = None
        if section.walls:
            walls = compute_walls_um(setup, rim_um=float(cells.helix_um.max()))
        return cells.to_cell_arrays(drift=(flow_x_um_s, flow_y_um_s), walls=walls)

    @property
    def poses(self) -> Poses:
        """The present poses of the bodies. Setting them moves the axes of the helices."""
        return self._poses

    @poses.setter
    def poses(self, poses: Poses) -> None:
        """Set the poses of the bodies, by placing each cell's axis accordingly."""
        cells = self.cells
        to_the_left_um = cells.helix_um * elementwise.cos(cells.phase)
        x_um, y_um = offset_to_left(poses.heading, to_the_left_um)
        cells.x[:] = poses.x * self._um_per_unit - x_um
        cells.y[:] = poses.y * self._um_per_unit - y_um
        cells.heading[:] = poses.heading
        self._poses = poses

    @property
    def moving(self) -> Floats:
        """1 for each cell that swims after its last command, 0 for the others, shape (N,)."""
        return self.cells.going.copy()

    commanded = moving

    def vary(self, a: Floats, speed: Floats) -> None:
        """Change the true turning rates a and speeds, shape (N,) each, starting now."""
        self.cells.a[:] = a
        self.cells.speed[:] = speed * self._um_per_unit

    def advance(self, since_ns: int, times_ns: Times, samples: Bools) -> Floats:
        """Move the cells, and return x, y and heading (M, 3, N); see `Drive.advance`."""
        n_steps = steps_until(since_ns, times_ns.tolist())
        n_cells = self.cells.x.size
        noise = self._random.standard_normal((n_steps, 2, n_cells))
        path = np.empty((times_ns.size, 3, n_cells))
        self._swim(self.cells, since_ns, times_ns, noise, self._um_per_unit, path)
        self._poses = Poses(*path[-1].copy())
        return path

    def apply(self, command: DelayedCommand) -> None:
        """Apply a command to those cells that it reaches.

        A direction sets the field and makes them swim. A stop makes them rest. `FieldOff` makes
        them swim without a field.
        """
        reached = command.reached
        field_x = 0.0
        field_y = 0.0
        if isinstance(command.action, Steer):
            field_x = cos(command.action.direction)
            field_y = sin(command.action.direction)
        self.cells.field_x[reached] = field_x
        self.cells.field_y[reached] = field_y
        self.cells.going[reached] = 0.0 if isinstance(command.action, Stop) else 1.0
