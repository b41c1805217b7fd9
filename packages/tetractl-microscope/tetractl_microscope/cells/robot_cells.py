"""Which cells of a dish are the robots, as two threads see it.

The trial's thread decides: to settle on cells, or to replace one, it puts another `RobotCells` in
the place of the present object, and changes none. The thread that searches pictures takes the
present object once a picture and writes to it what the picture shows: which cells are the robots at
first, and which of them have divided. What is written to an object that was replaced meanwhile
concerns robots that there are no more.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from tetractl.core.setup import Setup


@dataclass(slots=True)
class RobotCell:
    """The number of a robot's cell, and whether another cell has `divided` from its blob."""

    number: int
    divided: bool = False


@dataclass(eq=False, slots=True)
class RobotCells:
    """The cells that are the robots of a `setup`, in its order.

    There are none before all of them were seen in one image.
    """

    setup: Setup
    cells: Sequence[RobotCell] = ()

    @property
    def numbers(self) -> tuple[int, ...]:
        """The numbers of the cells."""
        return tuple(cell.number for cell in self.cells)

    @property
    def divided(self) -> tuple[int, ...]:
        """The indices of the robots whose cells have divided."""
        return tuple(i for i, cell in enumerate(self.cells) if cell.divided)

    def bind(self, numbers: Sequence[int]) -> None:
        """Let the cells with these numbers be the robots."""
        self.cells = [RobotCell(number) for number in numbers]
