"""Emulated cells in a dish: they swim by (1)-(3) with the field that truly is there.

Lengths are millimetres, as everywhere in the emulated lab. There are no walls, no collisions and
no third dimension.
"""

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass

from tetractl.core.clock import SECOND
from tetractl.emulate.field import STEP_NS, CurrentDriver
from tetractl.lab.actuators.field.coils import Coils, Pair
from tetractl.lab.actuators.field.protocol import DriverStatus


@dataclass(slots=True)
class Cell:
    """One cell as it truly is.

    x, y [mm] and heading [rad] in the spec's axes; `a` [rad/s] is its turning rate at the reference
    field, `speed` [mm/s]; `noise` [rad/s^0.5] makes the heading a Brownian motion. A `waiting` cell
    is held where it is: no cell does that by itself. One counts as `standing` while no field steers
    it, for it never does.
    """

    name: str
    x: float
    y: float
    heading: float
    a: float
    speed: float
    noise: float = 0.0
    waiting: bool = True
    standing: bool = True

    def place(self, x: float, y: float, heading: float) -> None:
        """Put the cell somewhere, to wait there."""
        self.x, self.y, self.heading = x, y, heading
        self.waiting = True

    def swim(self, field: Pair, seconds: float, random_source: random.Random) -> None:
        """Advance (1)-(3) by the midpoint rule, under a field in parts of the reference field.

        `field` is B / B_ref times the unit vector of u, so (3) reads a (field x (cos, sin)
        heading), with the vectors' cross product.
        """
        half = self.heading + self._turning(field, self.heading) * seconds / 2
        self.x += self.speed * math.cos(half) * seconds
        self.y += self.speed * math.sin(half) * seconds
        self.heading += self._turning(field, half) * seconds
        if self.noise:
            self.heading += self.noise * math.sqrt(seconds) * random_source.gauss(0.0, 1.0)

    def _turning(self, field: Pair, heading: float) -> float:
        return self.a * (field[1] * math.cos(heading) - field[0] * math.sin(heading))


class Dish:
    """Cells between the coils of an emulated driver.

    `coils` are the coils as they truly are, `reference_mt` the field at which the cells have
    their a. Cells that wait are let go when the driver first makes a field: a helper with a
    pipette is emulated, so that a trial begins with the cells on their starts.
    """

    def __init__(
        self,
        driver: CurrentDriver,
        coils: Coils,
        reference_mt: float,
        cells: Sequence[Cell],
        start_ns: int,
        seed: int,
    ) -> None:
        self.driver, self.coils, self.cells = driver, coils, tuple(cells)
        self._reference_mt = reference_mt
        self._random = random.Random(seed)
        self._now_ns = start_ns

    @property
    def field_mt(self) -> Pair:
        """The field where the cells are, in the spec's axes [mT]."""
        return self.coils.field(self.driver.currents)

    def advance(self, until_ns: int) -> None:
        """Move driver and cells on to `until_ns`, in steps of a millisecond."""
        while self._now_ns + STEP_NS <= until_ns:
            self._now_ns += STEP_NS
            self.driver.advance(self._now_ns)
            steered = DriverStatus.RUNNING in self.driver.status
            for cell in self.cells:
                cell.standing = not steered
                cell.waiting &= not steered
            x, y = self.field_mt
            field = x / self._reference_mt, y / self._reference_mt
            for cell in self.cells:
                if not cell.waiting:
                    cell.swim(field, STEP_NS / SECOND, self._random)
