"""The topics that the devices of a spec use, and whether this process publishes on them."""

from cyclonedds.idl import IdlStruct

from tetractl.core.setup import Setup
from tetractl.spec.lab_section import entry
from tetractl_ros2.ros2_messages import (
    BatteryState,
    Bool,
    NamedPoseArray,
    Odometry,
    PoseStamped,
    TFMessage,
    Twist,
    TwistStamped,
    Vector3Stamped,
)
from tetractl_ros2.section import Ros2CameraSection, Ros2Section
from tetractl_ros2.topic_port import Topic

POSE_MESSAGES: dict[str, type[IdlStruct]] = {
    "PoseStamped": PoseStamped,
    "Odometry": Odometry,
    "TFMessage": TFMessage,
    "NamedPoseArray": NamedPoseArray,
}
COMMAND_MESSAGES: dict[str, type[IdlStruct]] = {
    "Twist": Twist,
    "TwistStamped": TwistStamped,
    "Vector3Stamped": Vector3Stamped,
}
EMULATED_TOPIC = "/tetractl/emulated"
"""Topic on which an emulated tracker reports that it is not real."""


def pose_topics(section: Ros2CameraSection, setup: Setup, publishes: bool = False) -> list[Topic]:
    """Return the topics of the poses: one for all robots, or one for each robot in order.

    Args:
        section: The fields of the camera in the spec.
        setup: The constants of the experiment.
        publishes: Whether this program publishes on the topics.
    """
    message = POSE_MESSAGES[section.message]
    return [Topic(name, message, publishes) for name in section.topics(setup)]


def emulated_topic(publishes: bool = False) -> Topic:
    """Return the topic on which an emulated tracker reports that it is not real."""
    return Topic(EMULATED_TOPIC, Bool, publishes, latched=True)


def command_topics(section: Ros2Section, setup: Setup, publishes: bool = True) -> list[Topic]:
    """Return the topics of the robots' commands, in the setup's order.

    Args:
        section: The fields of the actuator in the spec.
        setup: The constants of the experiment.
        publishes: Whether this program publishes on the topics.
    """
    message = COMMAND_MESSAGES[section.message]
    robots = [entry(section.robots, name) for name in setup.names]
    return [Topic(robot.topic, message, publishes) for robot in robots]


def battery_topics(
    section: Ros2Section, setup: Setup, publishes: bool = False
) -> list[Topic | None]:
    """Return the topics of the robots' batteries, in the setup's order.

    An entry is None if the robot publishes no battery state.

    Args:
        section: The fields of the actuator in the spec.
        setup: The constants of the experiment.
        publishes: Whether this program publishes on the topics.
    """
    names = [entry(section.robots, name).battery for name in setup.names]
    return [None if name is None else Topic(name, BatteryState, publishes) for name in names]


def emergency_topic(section: Ros2Section, publishes: bool = True) -> Topic | None:
    """Return the topic of the emergency stop.

    The result is None if the section names no such topic.
    """
    if section.emergency_stop is None:
        return None
    return Topic(section.emergency_stop, Bool, publishes, latched=True)
