"""The emulated camera of type `ros2`: a motion-capture node that publishes poses."""

from collections.abc import Sequence
from typing import Any

from tetractl_emulator.loop import Loop
from tetractl_emulator.optitrack.tracked_body import View
from tetractl_emulator.pose_stream import PoseSettings, PoseStream, Shot
from tetractl_emulator.sides import Body, Facts, Stage

from tetractl.core.clock import SECOND
from tetractl.lab.cameras.optitrack.natnet import RigidBody, UpAxis
from tetractl.spec.lab_section import entry
from tetractl_ros2.emulated.plug import on_topics
from tetractl_ros2.ros2_messages import (
    Bool,
    Header,
    NamedPose,
    NamedPoseArray,
    Odometry,
    Point,
    PoseMessage,
    PoseStamped,
    PoseWithCovariance,
    Quaternion,
    TFMessage,
    Time,
    Transform,
    TransformStamped,
    Vector3,
)
from tetractl_ros2.section import Ros2CameraSection
from tetractl_ros2.topics import emulated_topic, pose_topics

EPOCH_NS = 1_700_000_000 * SECOND
"""Time that the tracker's clock shows when the emulation's clock shows 0 [ns].

The two clocks differ, like the clocks of two computers.
"""
EMULATED_MARK = Bool(data=True).serialize()
"""The message by which the tracker reports that it is emulated."""


class EmulatedTracker(PoseStream):
    """An emulated tracker that publishes the poses of all robots in the section's message type.

    All poses of a frame have the same time stamp. Untracked bodies are left out.
    """

    def __init__(self, stage: Stage, settings: PoseSettings, bodies: Sequence[Body]) -> None:
        section = stage.lab.camera
        assert isinstance(section, Ros2CameraSection), "the camera's type is ros2"
        topics = pose_topics(section, stage.setup, publishes=True)
        marker = emulated_topic(publishes=True)
        stage = on_topics(stage, section.domain, [*topics, marker])
        self._addresses = [topic.address(section.domain) for topic in topics]
        super().__init__(stage, settings, bodies)
        self.pose_section = section
        self._ports = [stage.wires.port(address) for address in self._addresses]
        self._marker = stage.wires.port(marker.address(section.domain))
        robots = [entry(section.robots, body.name) for body in bodies]
        self._bodies = [robot.body for robot in robots]
        x, y = section.origin
        self.view = View(UpAxis.Z, (x * stage.mm, y * stage.mm), section.rotation)
        for body, robot in zip(self.tracked, robots, strict=True):
            body.asset.heading_offset = robot.heading_offset

    def open(self, loop: Loop) -> Facts:
        """Join the ROS 2 topics of the emulated tracker, and expose its first frame."""
        for port in (*self._ports, self._marker):
            port.plug()
        self.begin()
        return {"camera": ", ".join(self._addresses)}

    def close(self) -> Facts:
        """Leave the topics, and return the number of frames sent, under the key "frames"."""
        for port in (*self._ports, self._marker):
            port.unplug()
        return {"frames": self.frames}

    def packed(self, shot: Shot) -> bytes:
        """Encode one message with the poses of all tracked robots.

        Untracked robots are left out.
        """
        return self._encode_message(shot, [body for body in shot.bodies if body.tracking_valid])

    def _stream(self, frame: Shot, now_ns: int) -> None:
        """Publish a frame as one message for all robots, or as a message on each robot's topic.

        Robots that are not tracked are left out. `now_ns` is not used.
        """
        self.frames += 1
        self._marker.write(EMULATED_MARK)
        if len(self._ports) == 1 and len(frame.bodies) > 1:
            self._ports[0].write(self.packed(frame))
            return
        for body in frame.bodies:
            if body.tracking_valid:
                self._ports[body.id].write(self._encode_message(frame, [body]))

    def _encode_message(self, shot: Shot, bodies: Sequence[RigidBody]) -> bytes:
        """Encode a message with the poses of bodies, in the section's coordinate frame.

        Its time stamp is the time of exposure, counted from EPOCH_NS.
        """
        sec, nanosec = divmod(EPOCH_NS + shot.exposed_ns, SECOND)
        header = Header(Time(sec, nanosec), self.pose_section.frame)
        return self._make_message(header, bodies).serialize()

    def _make_message(self, header: Header, bodies: Sequence[RigidBody]) -> Any:
        match self.pose_section.message:
            case "TFMessage":
                transforms: Any = [self._make_transform(header, body) for body in bodies]
                return TFMessage(transforms)
            case "NamedPoseArray":
                poses: Any = [
                    NamedPose(self._bodies[body.id], _pose_message(body)) for body in bodies
                ]
                return NamedPoseArray(header, poses)
            case "PoseStamped":
                return PoseStamped(header, _pose_message(bodies[0]))
            case "Odometry":
                child = self._bodies[bodies[0].id]
                return Odometry(header, child, PoseWithCovariance(_pose_message(bodies[0])))

    def _make_transform(self, header: Header, body: RigidBody) -> TransformStamped:
        transform = Transform(Vector3(*body.position), Quaternion(*body.quaternion))
        return TransformStamped(header, self._bodies[body.id], transform)


def _pose_message(body: RigidBody) -> PoseMessage:
    return PoseMessage(Point(*body.position), Quaternion(*body.quaternion))
