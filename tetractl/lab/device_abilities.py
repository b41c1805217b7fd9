"""Optional abilities of cameras beyond the protocol `Camera`.

A camera has an ability if it has the members of the protocol. Nothing needs to be declared.
"""

from collections.abc import Iterable
from typing import Protocol, runtime_checkable

from tetractl.core.guard_findings import Lose
from tetractl.core.poses import FrameAddition
from tetractl.core.setup import Setup
from tetractl.core.trial import Note
from tetractl.spec.lab_section import LabLimits


@runtime_checkable
class HearsDirections(Protocol):
    """A camera that is notified of each transmission, to identify robots by their response."""

    def steered(self, direction: float | None, sent_ns: int) -> None:
        """Record that a common direction was sent to all robots.

        The thread of the inner loop calls this method.

        Args:
            direction: The direction u [rad]. None if the field was switched off.
            sent_ns: The time of sending, on the run's clock [ns].
        """
        ...


@runtime_checkable
class AddsToFrames(Protocol):
    """A camera that measures more than poses, and adds its findings to the log."""

    def additions(self) -> list[FrameAddition]:
        """Return the additions to the camera's frames since the last call, oldest first."""
        ...


class RobotWatch(Protocol):
    """A camera's watch over the robots of one trial, which finds lost robots and replacements.

    The watch can decide that a robot is lost, and find a body that replaces the robot.
    """

    def see(self, sampled_ns: int) -> Iterable[Note]:
        """Process an accepted frame that was exposed at `sampled_ns` [ns].

        Returns:
            Notes for the operator and the log. Empty if there is nothing to report.
        """
        ...

    def lost(self) -> Iterable[Lose]:
        """Return each robot whose body the camera no longer knows, with the reason.

        The body may still be in view, as that of a cell that has divided.
        """
        ...

    def replace(self, robot: int) -> str:
        """Start to track another body in place of a lost robot.

        Returns:
            A description of the body. Empty if no body is similar to the robot.
        """
        ...


@runtime_checkable
class WatchesRobots(Protocol):
    """A camera that can decide which robots are lost, and which bodies replace them."""

    def watch(self, setup: Setup, limits: LabLimits) -> RobotWatch:
        """Create the watch for a trial with the robots of this setup."""
        ...
