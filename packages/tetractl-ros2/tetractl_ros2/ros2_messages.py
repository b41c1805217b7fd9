"""The ROS 2 messages that tetractl sends and reads, as DDS types.

ROS 2 maps a message `package/msg/Name` to the DDS type `package::msg::dds_::Name_`, with the same
fields in the same order, encoded as plain CDR (XCDR version 1). Each class below is one such type.
The definitions come from ROS 2's packages common_interfaces, rcl_interfaces and geometry2, and from
motion_capture_tracking; they have not changed since ROS 2 Foxy.

    message = Twist(linear=Vector3(x=0.2), angular=Vector3(z=0.5))
    message.serialize()                                 the bytes on the wire
"""

from dataclasses import dataclass, field
from typing import Any

from cyclonedds.idl import IdlStruct, types
from cyclonedds.idl.annotations import final

Covariance = types.array[types.float64, 36]
NAN = float("nan")


def _empty() -> Any:
    return []


def _zeros() -> Any:
    return [0.0] * 36


@final
@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    """A time since 1970, or since another origin that all nodes share."""

    sec: types.int32 = 0
    nanosec: types.uint32 = 0


@final
@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    """The time of a measurement, and the frame of its coordinates."""

    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@final
@dataclass
class Bool(IdlStruct, typename="std_msgs::msg::dds_::Bool_"):
    """A Boolean value."""

    data: bool = False


@final
@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    """A vector: of velocities [m/s], angular velocities [rad/s], or without a unit."""

    x: types.float64 = 0.0
    y: types.float64 = 0.0
    z: types.float64 = 0.0


@final
@dataclass
class Point(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    """A position [m]."""

    x: types.float64 = 0.0
    y: types.float64 = 0.0
    z: types.float64 = 0.0


@final
@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    """An orientation as a unit quaternion, with the real part in w."""

    x: types.float64 = 0.0
    y: types.float64 = 0.0
    z: types.float64 = 0.0
    w: types.float64 = 1.0


@final
@dataclass
class PoseMessage(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    """A position and an orientation (geometry_msgs/Pose)."""

    position: Point = field(default_factory=Point)
    orientation: Quaternion = field(default_factory=Quaternion)


@final
@dataclass
class PoseStamped(IdlStruct, typename="geometry_msgs::msg::dds_::PoseStamped_"):
    """A pose with its time and frame."""

    header: Header = field(default_factory=Header)
    pose: PoseMessage = field(default_factory=PoseMessage)


@final
@dataclass
class Twist(IdlStruct, typename="geometry_msgs::msg::dds_::Twist_"):
    """A velocity [m/s] and an angular velocity [rad/s]."""

    linear: Vector3 = field(default_factory=Vector3)
    angular: Vector3 = field(default_factory=Vector3)


@final
@dataclass
class TwistStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TwistStamped_"):
    """A twist with its time and frame."""

    header: Header = field(default_factory=Header)
    twist: Twist = field(default_factory=Twist)


@final
@dataclass
class Vector3Stamped(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3Stamped_"):
    """A vector with its time and frame."""

    header: Header = field(default_factory=Header)
    vector: Vector3 = field(default_factory=Vector3)


@final
@dataclass
class Transform(IdlStruct, typename="geometry_msgs::msg::dds_::Transform_"):
    """The position of a frame in its parent [m], and its orientation."""

    translation: Vector3 = field(default_factory=Vector3)
    rotation: Quaternion = field(default_factory=Quaternion)


@final
@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TransformStamped_"):
    """The transform from the header's frame to a child frame."""

    header: Header = field(default_factory=Header)
    child_frame_id: str = ""
    transform: Transform = field(default_factory=Transform)


@final
@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs::msg::dds_::TFMessage_"):
    """A list of transforms, as on the topic /tf."""

    transforms: types.sequence[TransformStamped] = field(default_factory=_empty)


@final
@dataclass
class PoseWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovariance_"):
    """A pose and the covariance of its six numbers."""

    pose: PoseMessage = field(default_factory=PoseMessage)
    covariance: Covariance = field(default_factory=_zeros)


@final
@dataclass
class TwistWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::TwistWithCovariance_"):
    """A twist and the covariance of its six numbers."""

    twist: Twist = field(default_factory=Twist)
    covariance: Covariance = field(default_factory=_zeros)


@final
@dataclass
class Odometry(IdlStruct, typename="nav_msgs::msg::dds_::Odometry_"):
    """A pose in the header's frame, and a twist in the child frame."""

    header: Header = field(default_factory=Header)
    child_frame_id: str = ""
    pose: PoseWithCovariance = field(default_factory=PoseWithCovariance)
    twist: TwistWithCovariance = field(default_factory=TwistWithCovariance)


@final
@dataclass
class NamedPose(IdlStruct, typename="motion_capture_tracking_interfaces::msg::dds_::NamedPose_"):
    """The pose of a tracked body."""

    name: str = ""
    pose: PoseMessage = field(default_factory=PoseMessage)


@final
@dataclass
class NamedPoseArray(
    IdlStruct, typename="motion_capture_tracking_interfaces::msg::dds_::NamedPoseArray_"
):
    """The poses of all tracked bodies at one time."""

    header: Header = field(default_factory=Header)
    poses: types.sequence[NamedPose] = field(default_factory=_empty)


@final
@dataclass
class BatteryState(IdlStruct, typename="sensor_msgs::msg::dds_::BatteryState_"):
    """The state of a battery: voltage [V] and charge as a fraction (`percentage`), or NaN."""

    header: Header = field(default_factory=Header)
    voltage: types.float32 = NAN
    temperature: types.float32 = NAN
    current: types.float32 = NAN
    charge: types.float32 = NAN
    capacity: types.float32 = NAN
    design_capacity: types.float32 = NAN
    percentage: types.float32 = NAN
    power_supply_status: types.uint8 = 0
    power_supply_health: types.uint8 = 0
    power_supply_technology: types.uint8 = 0
    present: bool = True
    cell_voltage: types.sequence[types.float32] = field(default_factory=_empty)
    cell_temperature: types.sequence[types.float32] = field(default_factory=_empty)
    location: str = ""
    serial_number: str = ""
