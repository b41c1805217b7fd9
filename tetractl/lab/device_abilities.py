"""What cameras and actuators may be able to do beyond `Camera` and `Actuator`, as protocols.

A device has an ability if it has the protocol's members; nothing needs to be declared.
"""

from collections.abc import Collection, Iterable, Sequence
from typing import Protocol, runtime_checkable

from tetractl.core.commands import FrameAddition, Note
from tetractl.core.guard_findings import Lose
from tetractl.core.setup import Setup
from tetractl.experiment.choice import RobotCandidate
from tetractl.experiment.lab_section import LabLimits


@runtime_checkable
class HearsDirections(Protocol):
    """A camera that receives each transmission, and so can distinguish robots by their response."""

    def steered(self, direction: float | None, sent_ns: int) -> None:
        """Take the common direction u [rad] sent at `sent_ns`; None if the field was switched off.

        Called in the inner loop's thread.
        """
        ...


@runtime_checkable
class AddsToFrames(Protocol):
    """A camera that knows more of its frames: messages to log."""

    def additions(self) -> list[FrameAddition]:
        """Return what was found in each picture since the last call, oldest first."""
        ...


class RobotWatch(Protocol):
    """What a camera knows of the robots of a trial beyond their poses."""

    def see(self, sampled_ns: int) -> Iterable[Note]:
        """Take the time of a frame that the guard has accepted; return what the log should say of
        it."""
        ...

    def lost(self) -> Iterable[Lose]:
        """Return each robot that counts as lost, although it may be in view, and why."""
        ...

    def replace(self, robot: int) -> str:
        """Follow another body in place of a lost robot from now on; return what it is, "" if none
        is like it."""
        ...


@runtime_checkable
class WatchesRobots(Protocol):
    """A camera that knows more of its robots than their poses: who is lost, and who replaces it."""

    def watch(self, setup: Setup, limits: LabLimits) -> RobotWatch:
        """Return the watch of a trial with this setup's robots."""
        ...


@runtime_checkable
class TracksCells(Protocol):
    """A camera that tracks all cells in view, of which some are the robots.

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
