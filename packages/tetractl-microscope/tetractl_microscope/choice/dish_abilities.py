"""What cameras and actuators may be able to do in a dish, beyond what a lab asks of them.

A device has an ability if it has the protocol's members; nothing needs to be declared.
"""

from collections.abc import Collection, Sequence
from typing import Protocol, runtime_checkable

from tetractl.core.errors import AbortError
from tetractl.core.setup import Setup
from tetractl.lab.rig import Rig
from tetractl_microscope.choice.candidate import RobotCandidate


@runtime_checkable
class TracksCells(Protocol):
    """A camera that tracks all cells in view, some of which are the robots.

    Trials that choose their robots need it, and robots that are replaced after their loss.
    """

    @property
    def robots(self) -> Sequence[int]:
        """The numbers of the robots' cells; empty before all were seen in one picture."""
        ...

    @property
    def divided(self) -> Collection[int]:
        """The indices of the robots from whose blob another cell separated."""
        ...

    def candidates(self) -> list[RobotCandidate]:
        """Return the cells in the newest picture whose identity is sure."""
        ...

    def settle(self, setup: Setup, numbers: Sequence[int]) -> None:
        """Track the cells with these numbers as the robots of a setup from now on."""
        ...

    def replace(self, robot: int, number: int) -> None:
        """From now on, track the cell with this number as the robot with the index `robot`."""
        ...


@runtime_checkable
class SettlesRobots(Protocol):
    """An actuator that can go on with the robots that a trial has chosen."""

    def settle(self, setup: Setup) -> None:
        """Continue with the robots of this setup."""
        ...


def tracker_of(rig: Rig) -> TracksCells:
    """Return the camera of a connected lab that tracks cells.

    Raises:
        AbortError: If it does not track cells.
    """
    if not isinstance(rig.camera, TracksCells):
        raise AbortError("this camera tracks its robots only, and finds no others")
    return rig.camera
