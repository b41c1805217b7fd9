"""What the guard reads of a robot in a camera frame, and what it decides on it."""

from dataclasses import dataclass
from enum import Enum

from tetractl.core.guard_findings import Finding
from tetractl.core.poses import Pose


@dataclass(frozen=True, slots=True)
class PoseReading:
    """A robot's pose in a frame, None if there is none; its time, and whether it is a new
    measurement.
    """

    pose: Pose | None
    exposed_ns: int
    is_new: bool


class PoseStatus(Enum):
    """What becomes of a robot's pose in a frame."""

    MISSING = "missing"  # there is none, or the robot is lost
    UNCHANGED = "unchanged"  # it was accepted or refused in a frame before
    ACCEPTED = "accepted"
    REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class PoseDecision:
    """What becomes of a robot's pose, why it is refused, whether that is since the robot disobeys,
    and what else its checks have found.
    """

    status: PoseStatus
    refused: str = ""
    disobeys: bool = False
    findings: tuple[Finding, ...] = ()
