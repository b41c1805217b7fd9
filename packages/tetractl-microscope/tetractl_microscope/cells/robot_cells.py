"""The cells that are the robots of a trial, shared by two threads.

The trial's thread decides which cells are the robots. To choose or replace a cell, it creates a new
`RobotCells` and never changes the present one. The thread that searches images takes the present
object once per image, and writes what the image shows to it: which cells are the robots at first,
and which of them have divided. Whatever is written to an object that was replaced in the meantime
concerns earlier robots.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from tetractl.core.setup import Setup


@dataclass(slots=True)
class RobotCell:
    """The cell of a robot.

    Attributes:
        number: Number of the cell.
        divided: Whether another cell has separated from its blob.
    """

    number: int
    divided: bool = False


@dataclass(eq=False, slots=True)
class RobotCells:
    """The cells that serve as the robots of a setup, as they appear in the images of the camera.

    Attributes:
        setup: The constants of the experiment.
        cells: The cell of each robot, in the order of the setup. Empty until one image has shown
            all of them.
    """

    setup: Setup
    cells: Sequence[RobotCell] = ()

    @property
    def numbers(self) -> tuple[int, ...]:
        """The numbers of the robots' cells, in the order of the setup."""
        return tuple(cell.number for cell in self.cells)

    @property
    def divided(self) -> tuple[int, ...]:
        """The indices of the robots whose cells have divided."""
        return tuple(i for i, cell in enumerate(self.cells) if cell.divided)

    def bind(self, numbers: Sequence[int]) -> None:
        """Assign a cell, given by its number, to each robot in the setup's order."""
        self.cells = [RobotCell(number) for number in numbers]
