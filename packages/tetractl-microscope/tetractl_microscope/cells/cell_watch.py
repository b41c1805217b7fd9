"""Watches whether it is still known which cells in a dish are the robots of a trial.

It decides which cells count as lost although they may be in view, and which other cell is steered
instead of a lost one.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

from tetractl.core.guard_findings import Lose
from tetractl.core.poses import Floats
from tetractl.core.setup import Setup
from tetractl.core.trial import Note
from tetractl_microscope.cells.identity_watch import IdentityWatch
from tetractl_microscope.choice.choosing import find_most_similar
from tetractl_microscope.choice.dish_abilities import TracksCells


@dataclass(frozen=True, slots=True)
class Identities:
    """The certainty, for one image, that each robot's cell is still the same cell.

    Attributes:
        exposed_ns: When the image was exposed [ns].
        probability: The probability for each robot, shape (N,). NaN if it is not seen.
    """

    exposed_ns: int
    probability: Floats


class CellWatch:
    """A `RobotWatch` that loses a robot if the identity of its cell is unknown for too long.

    Args:
        camera: The camera of the cells.
        waiting: The cells' identities in images that are not checked yet. The camera adds those of
            each image.
        setup: The constants of the experiment.
        patience_s: Time for which an identity may be unknown [s].
    """

    def __init__(
        self, camera: TracksCells, waiting: deque[Identities], setup: Setup, patience_s: float
    ) -> None:
        self._camera = camera
        self._waiting = waiting
        self._setup = setup
        self._identities = IdentityWatch(setup.names, patience_s)

    def see(self, sampled_ns: int) -> Iterator[Note]:
        """Check the robots' identities in a camera frame that the guard has accepted.

        Args:
            sampled_ns: When the frame was exposed [ns].

        Yields:
            A note for each robot whose identity becomes known or unknown.
        """
        while self._waiting and self._waiting[0].exposed_ns <= sampled_ns:
            identities = self._waiting.popleft()
            if identities.exposed_ns == sampled_ns:
                yield from self._identities.update(sampled_ns, identities.probability)

    def lost(self) -> Iterator[Lose]:
        """Yield each robot whose cell has divided or cannot be identified."""
        for robot in self._camera.divided:
            name = self._setup.names[robot]
            yield Lose(
                robot, f"{name} has divided, or has parted from an unknown cell that it had met"
            )
        for robot, reason in self._identities.unknown.items():
            yield Lose(robot, reason)

    def replace(self, robot: int) -> str:
        """Steer the most similar free cell instead of a lost robot.

        Returns:
            A text about that cell. Empty if no free cell is similar.
        """
        free_cells = [
            cell
            for cell in self._camera.candidates()
            if cell.magnetised and cell.free and cell.number not in self._camera.robots
        ]
        candidate = find_most_similar(self._setup, robot, free_cells)
        if candidate is None:
            return ""
        self._camera.replace(robot, candidate.number)
        self._identities.forget(robot)
        description = f"a {candidate.a:.2f} rad/s, speed {candidate.speed:.0f} {self._setup.unit}/s"
        return f"is now another cell: {description}"
