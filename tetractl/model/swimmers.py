"""The model of swimming cells that the simulation and the emulated microscope use.

A cell swims along a helix. The axis of the helix follows the paper's equations (1)-(3). Equation
(3) turns the axis, not the momentary velocity (Crenshaw). Lengths are in micrometres, whatever the
spec's unit is. `cell_numbers` contains measured properties of real cells.
"""

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from tetractl.core import elementwise
from tetractl.core.elementary import exp
from tetractl.core.poses import Bools, Floats
from tetractl.core.setup import Bounds, Setup
from tetractl.model.cell_numbers import (
    A_LOG_SD,
    A_RAD_S,
    ACTIVATION_EV,
    BODY_LENGTH_UM,
    BODY_WIDTH_UM,
    BOLTZMANN_EV_K,
    DIPOLE_SD_RAD,
    DIVIDED_LENGTH,
    DIVIDED_MAGNET,
    DIVIDED_TURN_RAD,
    HELIX_HZ,
    HELIX_UM,
    REFERENCE_C,
    SPEED_LOG_SD,
    SPEED_UM_S,
    WALK_RAD_S,
    ZERO_C_K,
)
from tetractl.model.motion import swimming
from tetractl.model.motion.swimming import CellArrays


def compute_speed_factor(temperature_c: float) -> float:
    """Compute the ratio of a cell's speed at a temperature [C] to its speed at 20 C.

    The ratio follows Arrhenius' law with the activation energy `ACTIVATION_EV`. It changes by about
    4 % per degree, and is valid for 10 to 28 C.

    Raises:
        ValueError: If the temperature is outside 0 to 40 C.
    """
    if not 0.0 <= temperature_c <= 40.0:
        raise ValueError(f"cells do not swim at {temperature_c:g} C; give 0 to 40")
    inverse = 1 / (ZERO_C_K + REFERENCE_C) - 1 / (ZERO_C_K + temperature_c)
    return exp(ACTIVATION_EV / BOLTZMANN_EV_K * inverse)


@dataclass
class Swimmers:
    """The true states of N swimming cells, as arrays of shape (N,).

    Attributes:
        x: x of the helix's axis [um].
        y: y of the helix's axis [um].
        heading: Direction of the axis [rad].
        depth: Height of the axis above the focal plane [um].
        phase: Position of the body on the helix [rad].
        length: Length of the body [um].
        width: Width of the body [um].
        speed: Speed along the axis [um/s].
        helix_um: Radius of the helix [um].
        helix_hz: Turns of the helix per second [Hz].
        a: Turning rate at the reference field [rad/s]. 0 for a cell without a magnet.
        bias: Angle from the axis to the cell's magnetic dipole [rad].
        walk: Random walk of the heading [rad/sqrt(s)].
        resting: Whether the cell rests instead of swimming.
    """

    x: Floats
    y: Floats
    heading: Floats
    depth: Floats
    phase: Floats
    length: Floats
    width: Floats
    speed: Floats
    helix_um: Floats
    helix_hz: Floats
    a: Floats
    bias: Floats
    walk: Floats
    resting: Bools

    @classmethod
    def drawn(
        cls,
        random: np.random.Generator,
        count: int,
        unmagnetised: int = 0,
        celsius: float = REFERENCE_C,
    ) -> Self:
        """Sample random cells, all at the origin.

        Args:
            random: The random generator.
            count: Number of cells.
            unmagnetised: Number of cells without a magnet, which come last.
            celsius: Temperature of the medium [C].
        """

        def sample_clipped(mean: float, deviation: float) -> Floats:
            return np.clip(random.normal(mean, deviation, count), 0.5 * mean, 1.5 * mean)

        a = A_RAD_S * elementwise.exp(random.normal(0, A_LOG_SD, count))
        a[count - unmagnetised :] = 0.0
        median_speed = SPEED_UM_S * compute_speed_factor(celsius)
        return cls(
            x=np.zeros(count),
            y=np.zeros(count),
            heading=random.uniform(-math.pi, math.pi, count),
            depth=random.normal(0, swimming.SINK_UM, count),
            phase=random.uniform(0, 2 * math.pi, count),
            length=sample_clipped(*BODY_LENGTH_UM),
            width=sample_clipped(*BODY_WIDTH_UM),
            speed=median_speed * elementwise.exp(random.normal(0, SPEED_LOG_SD, count)),
            helix_um=sample_clipped(*HELIX_UM),
            helix_hz=sample_clipped(*HELIX_HZ),
            a=a,
            bias=random.normal(0, DIPOLE_SD_RAD, count),
            walk=np.full(count, WALK_RAD_S),
            resting=np.zeros(count, bool),
        )

    def __len__(self) -> int:
        return len(self.x)

    def copy(self) -> Self:
        """Return an independent copy of the cells."""
        copied_columns = {name: values.copy() for name, values in vars(self).items()}
        return replace(self, **copied_columns)

    def joined(self, others: "Swimmers") -> "Swimmers":
        """Return these cells followed by other cells, as a new object."""
        other_columns = vars(others)
        columns = {
            name: np.append(values, other_columns[name]) for name, values in vars(self).items()
        }
        return Swimmers(**columns)

    def select(self, mask: Bools) -> "Swimmers":
        """Return the cells for which `mask`, shape (N,), is True, as a new object."""
        return Swimmers(**{name: values[mask] for name, values in vars(self).items()})

    def to_cell_arrays(
        self,
        field: tuple[float, float] = (0.0, 0.0),
        drift: tuple[float, float] = (0.0, 0.0),
        walls: Bounds | None = None,
    ) -> CellArrays:
        """Copy the cells to arrays for the functions `swimming.step` and `swim`.

        Args:
            field: The field B as a multiple of the reference field B_ref, in the direction u: x and
                y. The turning rate is proportional to the length of this vector.
            drift: Flow of the medium [um/s].
            walls: Edges along which cells slide [um]. None if there are none.
        """
        if walls is None:
            walls = Bounds(-math.inf, -math.inf, math.inf, math.inf)
        field_x, field_y = field
        drift_x, drift_y = drift
        count = len(self)
        return CellArrays(
            x=self.x.copy(),
            y=self.y.copy(),
            heading=self.heading.copy(),
            phase=self.phase.copy(),
            depth=self.depth.copy(),
            a=self.a.copy(),
            bias=self.bias.copy(),
            speed=self.speed.copy(),
            walk=self.walk.copy(),
            phase_rate=2 * math.pi * self.helix_hz,
            helix_um=self.helix_um.copy(),
            going=np.where(self.resting, 0.0, 1.0),
            field_x=np.full(count, field_x),
            field_y=np.full(count, field_y),
            flow_x=np.full(count, drift_x),
            flow_y=np.full(count, drift_y),
            wall_left=np.full(count, walls.left),
            wall_right=np.full(count, walls.right),
            wall_bottom=np.full(count, walls.bottom),
            wall_top=np.full(count, walls.top),
        )

    def swim(
        self,
        field: tuple[float, float],
        seconds: float,
        random: np.random.Generator,
        drift: tuple[float, float] = (0.0, 0.0),
        walls: Bounds | None = None,
    ) -> None:
        """Let every cell swim for a time, and change the states in place.

        Args:
            field: The field B as a multiple of the reference field B_ref, in the direction u: x and
                y. (0, 0) without a field.
            seconds: Duration [s].
            random: The random generator.
            drift: Flow of the medium [um/s].
            walls: Edges along which cells slide [um]. None if there are none.
        """
        noise = random.standard_normal((swimming.steps_in(seconds), 2, len(self)))
        # for a few cells, plain floats are ten times faster than arrays
        arrays = self.to_cell_arrays(field, drift, walls)
        cells = CellArrays(*(values.tolist() for values in arrays))
        swimming.step(cells, seconds, noise.tolist())
        self.x = np.array(cells.x)
        self.y = np.array(cells.y)
        self.heading = np.array(cells.heading)
        self.phase = np.array(cells.phase)
        self.depth = np.array(cells.depth)

    def set_resting(self, cell: int, resting: bool = True) -> None:
        """Make the cell with the index `cell` rest, or swim again if `resting` is False."""
        self.resting[cell] = resting

    def divide(self, cell: int, random: np.random.Generator) -> "Swimmers":
        """Return the cells after the cell with the index `cell` has divided.

        The new cell comes last. Both cells have the mother's width and 0.8 of its length, share its
        magnet unequally, and turn away from each other. The present object stays unchanged.
        """
        daughter = self.select(np.arange(len(self)) == cell)
        cells = self.copy()
        cells.length[cell] *= DIVIDED_LENGTH
        daughter.length *= DIVIDED_LENGTH
        magnet_fraction = random.uniform(*DIVIDED_MAGNET)
        cells.a[cell] *= 2 * magnet_fraction
        daughter.a *= 2 * (1 - magnet_fraction)
        turn_rad = random.uniform(*DIVIDED_TURN_RAD)
        cells.heading[cell] += turn_rad
        daughter.heading -= turn_rad
        return cells.joined(daughter)


def compute_walls_um(setup: Setup, rim_um: float = 0.0) -> Bounds:
    """Compute the edges of the arena in micrometres, each moved inwards by `rim_um` [um]."""
    um_per_unit = setup.metres * 1e6
    arena = setup.arena
    return Bounds(
        left=arena.left * um_per_unit + rim_um,
        bottom=arena.bottom * um_per_unit + rim_um,
        right=arena.right * um_per_unit - rim_um,
        top=arena.top * um_per_unit - rim_um,
    )


@dataclass(frozen=True, slots=True)
class Bodies:
    """The bodies of N cells as a camera sees them, as arrays of shape (N,).

    Attributes:
        x: x [um].
        y: y [um].
        height: Height above the focal plane [um].
        axis: Direction of the body in the image, which sways about the helix's axis [rad].
        tilt: Angle of the body out of the image's plane [rad].
    """

    x: Floats
    y: Floats
    height: Floats
    axis: Floats
    tilt: Floats


def offset_to_left(heading: Floats, distance_left: Floats) -> tuple[Floats, Floats]:
    """Compute the displacement x, y by `distance_left` to the left of a heading [rad]."""
    return -distance_left * elementwise.sin(heading), distance_left * elementwise.cos(heading)


def bodies(cells: Swimmers) -> Bodies:
    """Compute where the bodies of cells are, and how they are tilted, from their helices.

    At the speed v on a helix of frequency f and radius r, the tilt is at most atan(2 pi f r / v).
    """
    left_um = cells.helix_um * elementwise.cos(cells.phase)
    height_um = cells.helix_um * elementwise.sin(cells.phase)
    helix_rad_s = 2 * math.pi * cells.helix_hz
    left_x, left_y = offset_to_left(cells.heading, left_um)
    return Bodies(
        x=cells.x + left_x,
        y=cells.y + left_y,
        height=cells.depth + height_um,
        axis=cells.heading - elementwise.atan2(helix_rad_s * height_um, cells.speed),
        tilt=elementwise.atan2(helix_rad_s * left_um, cells.speed),
    )
