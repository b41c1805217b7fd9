"""What a check of the guard can find: a robot's newest pose is refused, a robot is lost, the
operator is warned, or the run is aborted.
"""

from dataclasses import dataclass

from tetractl.core.poses import Pose


@dataclass(frozen=True, slots=True)
class Refuse:
    """The newest pose of a robot is not accepted, since the robot cannot have come there."""

    robot: int
    text: str


@dataclass(frozen=True, slots=True)
class Moved:
    """A robot was seen to move in a pause, in which none is commanded to."""

    robot: int
    text: str


@dataclass(frozen=True, slots=True)
class Lose:
    """The run goes on without a robot; it is aborted if its spec does not allow that."""

    robot: int
    text: str


@dataclass(frozen=True, slots=True)
class Warn:
    """The operator is warned once; nothing else follows."""

    text: str


@dataclass(frozen=True, slots=True)
class Abort:
    """The run ends. The poses of the robots `false` are not accepted any more. `suspect` is the one
    robot that seems to be at fault, None if it is none or several: the guard then asks whether it
    was the camera, the radio or another robot.
    """

    text: str
    false: tuple[int, ...] = ()
    suspect: int | None = None


Finding = Refuse | Moved | Lose | Warn | Abort


@dataclass(frozen=True, slots=True)
class RobotPlace:
    """Where a robot is at a tick: its `pose`, None if it is not tracked, the last one if it is
    `lost`. It may drive the `way` [length unit] before it can be stopped.
    """

    pose: Pose | None
    lost: bool
    way: float
