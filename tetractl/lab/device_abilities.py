"""What cameras may be able to do beyond `Camera`, as protocols.

A camera has an ability if it has the protocol's members; nothing needs to be declared.
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
    """A camera that receives each transmission, and so can distinguish robots by their response."""

    def steered(self, direction: float | None, sent_ns: int) -> None:
        """Take note of a common direction u [rad]. None if the field was switched off.

        It is called in the inner loop's thread, with the time of sending.
        """
        ...


@runtime_checkable
class AddsToFrames(Protocol):
    """A camera that knows more of its frames: messages to log."""

    def additions(self) -> list[FrameAddition]:
        """Return the findings in each image since the last call, oldest first."""
        ...


class RobotWatch(Protocol):
    """What a camera knows of the robots of a trial beyond their poses."""

    def see(self, sampled_ns: int) -> Iterable[Note]:
        """Take note of the time of an accepted frame, and return notes about it for the log."""
        ...

    def lost(self) -> Iterable[Lose]:
        """Return each robot that counts as lost, although it may be in view, and why."""
        ...

    def replace(self, robot: int) -> str:
        """Track another body instead of a lost robot from now on.

        Returns:
            What the body is. Empty if none is similar to the robot.
        """
        ...


@runtime_checkable
class WatchesRobots(Protocol):
    """A camera that knows more of its robots than their poses: who is lost, and who replaces it."""

    def watch(self, setup: Setup, limits: LabLimits) -> RobotWatch:
        """Return the watch of a trial with this setup's robots."""
        ...
