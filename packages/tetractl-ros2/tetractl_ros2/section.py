"""The sections of the spec for ROS 2: `type: ros2` of camera and actuator."""

import math
import re
from collections.abc import Callable, Iterator, Sequence
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, Field

from tetractl.core.errors import UsageError
from tetractl.core.setup import Setup
from tetractl.lab.actuators.wheeled_section import SpeedRobot, SpeedSection
from tetractl.spec.base import Angle, NonNegative, Point
from tetractl.spec.lab_section import (
    CameraSection,
    LabLimits,
    LabSection,
    Measured,
    RobotPart,
    entry,
    mismatches,
)
from tetractl.spec.yaml.problems import Loc

BODY_PLACEHOLDER = "{body}"
"""Placeholder in the name of a topic for each robot's `body`.

With it, each robot has its own topic.
"""
TOPIC_NAME = re.compile(r"(/[A-Za-z_{][A-Za-z0-9_{}]*)+")
DIRECTION = "Vector3Stamped"
"""The message of robots that steer themselves by the common direction."""
RATE_PER_WATCHDOG = 3
"""Minimum number of commands within `stops_after`, because some may be lost."""

Domain = Annotated[int, Field(ge=0, le=232)]
PoseMessageName = Literal["PoseStamped", "Odometry", "TFMessage", "NamedPoseArray"]
USUAL_TOPICS: dict[str, str] = {
    "PoseStamped": "/{body}/pose",
    "Odometry": "/{body}/odom",
    "TFMessage": "/tf",
    "NamedPoseArray": "/poses",
}
"""The topic of each kind of poses, unless the section names another."""


def _require_full_name(topic: str) -> str:
    """Check that a string is the full name of a topic, and return the string.

    Raises:
        ValueError: If it is not a full name.
    """
    if TOPIC_NAME.fullmatch(topic) is None:
        raise ValueError("must be a full topic name, such as /green/cmd_vel")
    return topic


TopicName = Annotated[str, Field(max_length=200), AfterValidator(_require_full_name)]


class BodyOfRobot(RobotPart):
    """The entry of one robot in the spec's camera section: its body in the ROS 2 graph."""

    body: str = Field(min_length=1, max_length=200)
    """What the graph calls the robot: its child frame, its name in a NamedPoseArray, or the part of
    its topic's name that stands for {body}."""
    heading_offset: Angle = 0.0
    """Angle added to the body's heading to give the robot's heading [rad]."""


class Ros2CameraSection(CameraSection):
    """Poses on topics of a ROS 2 graph, from a motion-capture node, /tf, or robots' odometry."""

    device: ClassVar[str] = "tetractl_ros2.camera:Ros2Camera"
    type: Literal["ros2"]
    domain: Domain = 0
    """The ROS domain: ROS_DOMAIN_ID of the other nodes."""
    message: PoseMessageName
    """The message that holds poses: geometry_msgs/PoseStamped or nav_msgs/Odometry, one topic for
    each robot; tf2_msgs/TFMessage; or motion_capture_tracking_interfaces/NamedPoseArray."""
    topic: TopicName | None = None
    """The topic; {body} stands for each robot's body. By default /{body}/pose, /{body}/odom, /tf or
    /poses."""
    frame: str = Field(min_length=1, max_length=200)
    """The frame of the poses, as in their headers: one that is fixed to the floor. Poses in other
    frames are not used."""
    origin: Point = (0.0, 0.0)
    """Position of the frame's origin in the spec's coordinates [length unit]."""
    rotation: Angle = 0.0
    """Angle from the spec's x axis to the frame's x axis [rad]."""
    latency: NonNegative = Field(default=0.01, le=0.5)
    """Time from the stamp in a header until its message arrives [s], when it arrives quickly."""
    robots: tuple[BodyOfRobot, ...] = Field(min_length=1, max_length=32)
    """One entry for each robot of the spec."""

    @property
    def topic_pattern(self) -> str:
        """The name of the topic with the poses, by default the usual topic of the message.

        If each body has its own topic, the name contains {body}.
        """
        return self.topic or USUAL_TOPICS[self.message]

    @property
    def address(self) -> str:
        """The ROS 2 domain and the name of the topic, for display."""
        return f"ros2://{self.domain}{self.topic_pattern}"

    def topics(self, setup: Setup) -> tuple[str, ...]:
        """Return the names of the topics: one for all robots, or one for each robot in order."""
        pattern = self.topic_pattern
        if BODY_PLACEHOLDER not in pattern:
            return (pattern,)
        bodies = [entry(self.robots, name).body for name in setup.names]
        return tuple(pattern.replace(BODY_PLACEHOLDER, body) for body in bodies)

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield the place and a message for each problem with robots, bodies and topics."""
        yield from mismatches(self.robots, setup.names, ("body",))
        pattern = self.topic_pattern
        if self.message in ("PoseStamped", "Odometry") and BODY_PLACEHOLDER not in pattern:
            yield (
                ("topic",),
                (
                    f"must contain {BODY_PLACEHOLDER}, because a {self.message} does not say "
                    "which robot it shows"
                ),
            )
        if pattern.replace(BODY_PLACEHOLDER, "").count("{"):
            yield ("topic",), f"may contain {BODY_PLACEHOLDER}, but no other braces"
        for i, robot in enumerate(self.robots):
            if BODY_PLACEHOLDER in pattern and TOPIC_NAME.fullmatch(f"/{robot.body}") is None:
                yield (
                    ("robots", i, "body"),
                    "must consist of letters, digits and _, because it is part of a topic's name",
                )

    def bounds(self) -> dict[str, str]:
        """Return the topic and the frame as {name: text}, for display."""
        source_text = f"{self.message} on {self.topic_pattern}, ROS domain {self.domain}"
        return {"poses": f"{source_text}, in frame {self.frame}"}

    def heading_offset(self, name: str) -> float:
        """Return the angle added to the heading of a robot's body [rad]."""
        return entry(self.robots, name).heading_offset


class Ros2Robot(SpeedRobot):
    """The entry of one robot in the spec's actuator section: its topics and its wheels."""

    topic: TopicName
    """The topic of its commands, such as /green/cmd_vel."""
    battery: TopicName | None = None
    """The topic of its sensor_msgs/BatteryState; None if it has none."""


class Ros2Section(SpeedSection):
    """Robots of a ROS 2 graph that receive twists, or the common direction."""

    device: ClassVar[str] = "tetractl_ros2.actuator:Ros2Robots"
    stopping: ClassVar[str] = "tetractl_ros2.actuator:stop_all"
    unit_mm: ClassVar[float] = 0.1
    """The wheel speed that counts as 1 [mm/s]: a Twist holds numbers that are not whole."""
    type: Literal["ros2"]
    domain: Domain = 0
    """The ROS domain: ROS_DOMAIN_ID of the robots."""
    message: Literal["Twist", "TwistStamped", "Vector3Stamped"] = "Twist"
    """The message of a command, of geometry_msgs. Robots that steer themselves take Vector3Stamped:
    the common direction u as (cos u, sin u, 0), (0, 0, 0) to stand, and z = 1 to turn on the spot.
    They turn towards u at a sin(u - heading) and drive at their speed, by the spec's values."""
    stops_after: float | None = Field(default=None, ge=0.1, le=5, allow_inf_nan=False)
    """Time without a command after which a robot's own program stops it [s]. ROS 2 has no such
    watchdog: the robot's driver must. None if it has none."""
    emergency_stop: TopicName | None = None
    """A topic of std_msgs/Bool at which true stops the robots until they are released by hand; None
    if there is none."""
    battery_warn: float = Field(default=20.0, ge=0, le=100, allow_inf_nan=False)
    """A warning is printed for a robot whose battery is below this charge [%]."""
    robots: tuple[Ros2Robot, ...] = Field(min_length=1, max_length=32)
    """One entry for each robot of the spec."""

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield place and message for each problem with robots, topics, wheels, speeds and rate."""
        yield from mismatches(self.robots, setup.names, ("topic", "battery"))
        yield from self.wheel_contradictions(setup, self.robots)
        for i, robot in enumerate(self.robots):
            for key in ("topic", "battery"):
                if "{" in (getattr(robot, key) or ""):
                    yield ("robots", i, key), "must be a full topic name, such as /green/cmd_vel"
        if self.stops_after is None:
            if math.isfinite(setup.watchdog_s):
                message = (
                    "is missing, although wheels.watchdog says that the robots stop "
                    f"after {setup.watchdog_s:g} s"
                )
                yield ("stops_after",), message
            return
        if setup.watchdog_s > self.stops_after:
            yield (
                (),
                (
                    f"robots stop after {self.stops_after:g} s without a command, so the spec "
                    "must not state a longer time: set wheels.watchdog to this value"
                ),
            )
        if self.rate * self.stops_after < RATE_PER_WATCHDOG:
            yield (
                ("rate",),
                f"must be high enough for {RATE_PER_WATCHDOG} commands within "
                f"{self.stops_after:g} s",
            )

    def beside(self, camera: CameraSection) -> Iterator[tuple[Loc, str]]:
        """Yield an error if robots that steer themselves would use different axes from the spec.

        This is the case if the camera is of type ros2 and its `rotation` is not 0.
        """
        is_rotated = isinstance(camera, Ros2CameraSection) and camera.rotation != 0
        if self.message == DIRECTION and is_rotated:
            message = "sends directions in the spec's axes, so camera.rotation must be 0"
            yield ("message",), message

    def calibrate(
        self,
        lab: LabSection,
        make_rig: Callable[[LabLimits, Setup], Any],
        setup: Setup,
        names: Sequence[str],
        limit: int,
        report: Callable[[str], None],
    ) -> Measured:
        """Calibrate the robots; see `ActuatorSection.calibrate`.

        Raises:
            UsageError: If the robots steer themselves.
        """
        if self.message == DIRECTION:
            raise UsageError("robots that steer themselves cannot be calibrated by tetractl")
        return super().calibrate(lab, make_rig, setup, names, limit, report)

    def bounds(self) -> dict[str, str]:
        """Return topics, rate, watchdog and maximum wheel speed as {name: text}, for display."""
        topics = ", ".join(robot.topic for robot in self.robots)
        timeout_text = (
            "never by themselves" if self.stops_after is None else f"after {self.stops_after:g} s"
        )
        return {
            "robots": f"{topics} in ROS domain {self.domain}, {self.rate:g} commands a second each",
            "robots without commands stop": timeout_text,
            "wheel speeds": f"at most {self.speed_max_mm_s:g} mm/s",
        }
