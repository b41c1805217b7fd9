"""Simulated cells that swim in the field of an emulated coil driver, in real or virtual time."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from tetractl_microscope.coils.section import CoilPair, CoilsSection, Pair

from tetractl.core.clock import MILLISECOND, SECOND
from tetractl.core.setup import Bounds, Setup
from tetractl.model.swimmers import Swimmers
from tetractl_emulator.faults import ActingFaults

SWIM_NS = 2 * MILLISECOND
"""Time step of the cells' motion [ns]."""
UM_MM = 1000.0
"""Micrometres per millimetre."""
DROP = 0.25
"""Maximum distance of a drop's cells from the middle of the dish, in widths of the dish."""


class CoilField:
    """Converts coil currents to the magnetic field at the cells, including faults of the coils.

    Args:
        section: The coils' section of the spec: gains and orientation.
        reference_mt: Reference field strength [mT], at which the cells turn with their rates a of
            equation (3) of the paper.
        acting: The faults that act now. They can weaken or turn the coils.
    """

    def __init__(self, section: CoilsSection, reference_mt: float, acting: ActingFaults) -> None:
        self._section = section
        self._reference_mt = reference_mt
        self._acting = acting

    @property
    def coils(self) -> CoilsSection:
        """The coils of the spec, as the acting faults change them."""
        coils = self._section
        for fault in self._acting.of_kind("weak_coils"):
            pair: CoilPair = getattr(coils, fault.axis)
            weakened = pair.model_copy(update={"gain_mt_a": fault.share * pair.gain_mt_a})
            coils = coils.model_copy(update={fault.axis: weakened})
        for fault in self._acting.of_kind("turned_coils"):
            coils = coils.model_copy(update={"rotation": coils.rotation + fault.by})
        return coils

    def field_mt(self, currents: Pair) -> Pair:
        """Compute the magnetic field of the coil currents (x, y) [A] at the cells.

        Returns:
            The field [mT] along the spec's x and y axes.
        """
        return self.coils.field(currents)

    def relative(self, currents: Pair) -> Pair:
        """Compute the magnetic field of the coil currents (x, y) [A], relative to the reference.

        Returns:
            The field along the spec's x and y axes, divided by the reference strength.
        """
        x_mt, y_mt = self.field_mt(currents)
        return x_mt / self._reference_mt, y_mt / self._reference_mt


class Dish:
    """Cells that swim between the coils of a driver.

    A cell that was placed by hand stays where it is until the driver first makes a field, as if a
    helper held it with a pipette. A trial therefore begins with the cells on their starts. Set
    `held` to False to let placed cells swim at once.

    Args:
        driver: A `CurrentDriver`, or an object with its `currents`, `running` and `advance`.
        field: The field of the driver's coils.
        cells: The cells.
        start_ns: Time at which the emulation starts [ns].
        seed: Seed of all random numbers.
        walls: The edges along which cells slide [um]. None for a dish without edges.

    Attributes:
        cells: The cells.
        held: Whether a placed cell stays where it is until the driver first makes a field.
        steered: Whether the driver makes a field at present.
    """

    def __init__(
        self,
        driver: Any,
        field: CoilField,
        cells: Swimmers,
        start_ns: int,
        seed: int,
        walls: Bounds | None = None,
    ) -> None:
        self.driver = driver
        self.field = field
        self.cells = cells
        self.held = True
        self.steered = False
        self._walls = walls
        self._random = np.random.default_rng(seed)
        self._now_ns = start_ns
        self._swum_ns = start_ns
        self.drop()

    def drop(self) -> None:
        """Scatter the cells around the middle of the dish, like a fresh drop from a pipette.

        Nothing happens in a dish without edges.
        """
        walls = self._walls
        if walls is None:
            return
        count = len(self.cells)
        random_generator = self._random
        for positions, low, size in (
            (self.cells.x, walls.left, walls.width),
            (self.cells.y, walls.bottom, walls.height),
        ):
            positions[:] = low + size * random_generator.uniform(0.5 - DROP, 0.5 + DROP, count)
        self.cells.heading[:] = random_generator.uniform(-np.pi, np.pi, count)

    def divide(self, row: int) -> None:
        """Divide the cell with this index.

        The daughter becomes the last cell, so no index changes.
        """
        self.cells = self.cells.divide(row, self._random)

    @property
    def field_mt(self) -> Pair:
        """The magnetic field at the cells [mT], along the spec's x and y axes."""
        return self.field.field_mt(self.driver.currents)

    def advance(self, until_ns: int) -> None:
        """Advance the driver and the cells in steps of 1 ms, up to the time `until_ns` [ns].

        Resting cells start to swim again when the driver starts. A remainder of less than 1 ms is
        left for the next call.
        """
        while self._now_ns + MILLISECOND <= until_ns:
            self._now_ns += MILLISECOND
            self.driver.advance(self._now_ns)
            is_running = self.driver.running
            if is_running and not self.steered:
                self.cells.resting[:] = False
            self.steered = is_running
            if self._now_ns - self._swum_ns >= SWIM_NS:
                field = self.field.relative(self.driver.currents)
                elapsed_s = (self._now_ns - self._swum_ns) / SECOND
                self.cells.swim(field, elapsed_s, self._random, walls=self._walls)
                self._swum_ns = self._now_ns


class CellBody:
    """The true pose of one cell of a dish: x, y [mm], and heading [rad].

    The heading is the direction of the axis of the cell's helix. A cell never stands still, but
    counts as standing while the driver makes no field.

    Args:
        name: Name of the cell.
        dish: The dish.
        row: Index of the cell in the dish.
    """

    def __init__(self, name: str, dish: Dish, row: int) -> None:
        self.name = name
        self.dish = dish
        self.row = row

    @property
    def x(self) -> float:
        """True position x of the cell in the spec's axes [mm]."""
        return float(self.dish.cells.x[self.row]) / UM_MM

    @property
    def y(self) -> float:
        """True position y of the cell in the spec's axes [mm]."""
        return float(self.dish.cells.y[self.row]) / UM_MM

    @property
    def heading(self) -> float:
        """The direction in which the cell swims, in the spec's axes [rad]."""
        return float(self.dish.cells.heading[self.row])

    @property
    def standing(self) -> bool:
        """Whether the driver makes no field to steer the cell, although the cell may swim on."""
        return not self.dish.steered

    def place(self, x: float, y: float, heading: float) -> None:
        """Put the cell at a pose. It stays there if the dish is `held`; see `Dish`.

        Args:
            x: x [mm].
            y: y [mm].
            heading: Heading [rad].
        """
        cells = self.dish.cells
        row = self.row
        cells.x[row] = x * UM_MM
        cells.y[row] = y * UM_MM
        cells.heading[row] = heading
        cells.resting[row] = self.dish.held


def cells_of(setup: Setup, walk: float, seed: int) -> Swimmers:
    """Generate one cell for each robot of a setup, with the robot's turning rate and speed.

    The other properties are random, except for the dipole's angle from the axis, which is 0.

    Args:
        setup: The constants of the experiment.
        walk: Random walk of the headings [rad/sqrt(s)].
        seed: Seed of the random properties.
    """
    cells = Swimmers.drawn(np.random.default_rng(seed), len(setup.names))
    cells.a = setup.a.copy()
    cells.speed = setup.speed * setup.metres * 1e6
    cells.bias[:] = 0.0
    cells.walk[:] = walk
    return cells


def culture(count: int, strangers: int, walk: float, seed: int) -> tuple[Swimmers, Sequence[str]]:
    """Generate random cells and their names.

    Args:
        count: Number of cells with a magnet. They come first and are named "cell 1", "cell 2", ...
        strangers: Number of cells without a magnet, named "stranger ...".
        walk: Random walk of the headings [rad/sqrt(s)].
        seed: Seed of the cells.

    Returns:
        The cells and their names, in the same order.
    """
    cells = Swimmers.drawn(np.random.default_rng(seed), count + strangers, strangers)
    cells.walk[:] = walk
    kinds = ["cell"] * count + ["stranger"] * strangers
    return cells, [f"{kind} {i + 1}" for i, kind in enumerate(kinds)]
