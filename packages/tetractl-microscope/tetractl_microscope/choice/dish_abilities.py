"""Optional abilities of cameras and actuators that are used with cells in a dish.

A device has an ability if it has the members of the protocol. Nothing needs to be declared.
"""

from collections.abc import Collection, Sequence
from typing import Protocol, runtime_checkable

from tetractl.core.errors import AbortError
from tetractl.core.setup import Setup
from tetractl.lab.rig import Rig
from tetractl_microscope.choice.candidate import RobotCandidate


@runtime_checkable
class TracksCells(Protocol):
    """A camera that tracks all cells in view. Some of the cells are the robots.

    Trials that choose their robots need this ability, and so do trials that replace a lost robot.
    """

    @property
    def robots(self) -> Sequence[int]:
        """The numbers of the robots' cells, in the setup's order.

        It is empty until one image has shown all of them.
        """
        ...

    @property
    def divided(self) -> Collection[int]:
        """The indices of the robots whose cell has divided.

        A cell has divided if another cell separated from its blob.
        """
        ...

    def candidates(self) -> list[RobotCandidate]:
        """Return the cells in the newest image whose identity is certain, also those of robots.

        The list is empty if there are none.
        """
        ...

    def settle(self, setup: Setup, numbers: Sequence[int]) -> None:
        """Start to track the cells with these numbers as the robots of a setup.

        Args:
            setup: The constants of the experiment.
            numbers: Number of each robot's cell, in the order of the setup's robots.
        """
        ...

    def replace(self, robot: int, number: int) -> None:
        """Start to track another cell as a robot.

        Args:
            robot: Index of the robot.
            number: Number of the cell.
        """
        ...


@runtime_checkable
class SettlesRobots(Protocol):
    """An actuator that can change to other robots: those that a trial has chosen in the dish."""

    def settle(self, setup: Setup) -> None:
        """Replace the robots by the robots of this setup, starting now."""
        ...


def require_cell_tracker(rig: Rig) -> TracksCells:
    """Return the camera of a connected lab, and check that it tracks cells.

    Raises:
        AbortError: If the camera cannot track cells other than its robots.
    """
    if not isinstance(rig.camera, TracksCells):
        raise AbortError(
            "this camera only tracks the robots of the spec, and cannot find other cells"
        )
    return rig.camera
