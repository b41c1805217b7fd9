"""The findings that the checks of a lab's guard can report.

A finding refuses a robot's newest pose, declares a robot lost, warns the operator, or aborts the
run.
"""

from dataclasses import dataclass

from tetractl.core.poses import Pose


@dataclass(frozen=True, slots=True)
class Excess:
    """A measured value that is beyond its limit, and the limit.

    Attributes:
        check: Name of the check or rule, such as "drift".
        value: The measured value, in `unit`.
        limit: The limit, in `unit`. The value is above a maximum, or below a minimum.
        unit: Unit of the value and the limit. Empty for numbers without a unit.
        robot: Index of the robot. None if the value concerns no single robot.
    """

    check: str
    value: float
    limit: float
    unit: str = ""
    robot: int | None = None


@dataclass(frozen=True, slots=True)
class Refuse:
    """A finding: a robot's newest pose is refused, because the robot cannot have reached it.

    Attributes:
        robot: Index of the robot.
        text: The reason.
        excess: The measured value with its limit. None if the reason is not a limit.
    """

    robot: int
    text: str
    excess: Excess | None = None


@dataclass(frozen=True, slots=True)
class Moved:
    """A finding: a robot moved between two runs, although no robot was commanded to move.

    Attributes:
        robot: Index of the robot.
        text: What happened, for the operator.
    """

    robot: int
    text: str


@dataclass(frozen=True, slots=True)
class Lose:
    """A finding: a robot is lost, so that the run continues without it or ends.

    The run continues without it, or is aborted if the spec does not allow that.

    Attributes:
        robot: Index of the robot.
        text: The reason.
        excess: The measured value with its limit. None if the reason is not a limit.
    """

    robot: int
    text: str
    excess: Excess | None = None


@dataclass(frozen=True, slots=True)
class Warn:
    """A finding: the guard warns the operator once with the message `text`. The run continues."""

    text: str


@dataclass(frozen=True, slots=True)
class Abort:
    """A finding of the guard's check: the run has to end at once.

    Attributes:
        text: The reason.
        false: Indices of the robots whose poses can no longer be trusted.
        suspect: Index of the robot that seems to have failed. None if it is not a single robot. The
            guard then checks whether the camera, the radio or another robot was the cause.
        excess: The measured value with its limit. None if the reason is not a limit.
    """

    text: str
    false: tuple[int, ...] = ()
    suspect: int | None = None
    excess: Excess | None = None


Finding = Refuse | Moved | Lose | Warn | Abort


@dataclass(frozen=True, slots=True)
class RobotPlace:
    """The place of a robot at the moment when the guard decides whether it may continue to move.

    Attributes:
        pose: Pose of the robot. None if the robot is untracked. For a lost robot, its last pose.
        lost: Whether the robot is lost.
        way: Distance that the robot may still drive before it can be stopped [length unit].
    """

    pose: Pose | None
    lost: bool
    way: float
