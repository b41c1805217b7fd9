"""What the guard reads of a robot in a camera frame, and what it decides on it."""

from dataclasses import dataclass

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


@dataclass(frozen=True, slots=True)
class PoseDecision:
    """What becomes of a robot's pose: it is `accepted`, or why it is `refused`, and whether that is
    since the robot disobeys; neither if there is none. `findings` are what checks found besides.
    """

    accepted: Pose | None = None
    refused: str = ""
    disobeys: bool = False
    findings: tuple[Finding, ...] = ()
