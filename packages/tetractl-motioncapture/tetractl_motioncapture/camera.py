"""A `Camera` that reads frames of named rigid bodies from a motion-capture system.

The frames are lines of JSON, printed by a child process (`bridge`).
"""

import json
from collections.abc import Callable
from typing import Any

from tetractl.core.clock import Clock
from tetractl.core.errors import printable
from tetractl.core.poses import Pose
from tetractl.core.protocols import Health
from tetractl.core.setup import Setup
from tetractl.lab.cameras.optitrack.natnet import Placement, RigidBody, UpAxis
from tetractl.lab.cameras.port_camera import PortCamera
from tetractl.lab.serial_port import PortFactory, SerialPort
from tetractl.spec.lab_section import entry
from tetractl_motioncapture.process_port import ProcessPort
from tetractl_motioncapture.section import MotionCaptureSection

NAME_MAX = 60
"""Maximum number of characters shown of a streamed body's name, which any sender chooses."""
NAMES_MAX = 20
"""Maximum number of streamed bodies that a message lists."""


class MotionCapture(PortCamera):
    """Tracks the setup's robots by their rigid bodies; see `tetractl.core.protocols.Camera`.

    Args:
        section: The camera's section of the spec.
        setup: The constants of the experiment.
        clock: The clock for times.
        wake: Called when a frame has arrived.
        ports: Creates the port to read from. By default, the port to the library's process.
    """

    connect_s = 10.0
    hint = "does the motion-capture system stream, and are lab.camera.system and hostname right?"

    section: MotionCaptureSection

    def __init__(
        self,
        section: MotionCaptureSection,
        setup: Setup,
        clock: Clock,
        wake: Callable[[], None] = lambda: None,
        ports: PortFactory | None = None,
    ) -> None:
        self.robots = [entry(section.robots, name) for name in setup.names]
        self._streamed_names: list[str] = []
        self._up_axis = UpAxis.Z if section.up_axis == "z" else UpAxis.Y
        self._placement = Placement(*section.origin, section.rotation, 1.0 / setup.metres)
        super().__init__(section, setup, clock, wake, ports)

    def port(self, *arguments: Any) -> SerialPort:
        """Create the port to the library's process."""
        section = self.section
        name = json.dumps([section.system, section.hostname, section.options])
        return ProcessPort(name, *arguments[1:])

    def check(self) -> Health:
        """Check whether the rigid body of every robot is streamed. Each missing body is a problem.

        The newest frame decides.
        """
        untracked = [robot for robot in self.robots if str(robot.body) not in self._streamed_names]
        streamed_names = ", ".join(
            printable(name, NAME_MAX) for name in self._streamed_names[:NAMES_MAX]
        )
        unlisted_count = len(self._streamed_names) - NAMES_MAX
        streamed_names = (
            f"{streamed_names or 'none'} and {unlisted_count} more"
            if unlisted_count > 0
            else streamed_names or "none"
        )
        problems = [
            f"the system streams no rigid body {robot.body} for {robot.name}; it streams "
            f"{streamed_names}"
            for robot in untracked
        ]
        return Health(tuple(problems), emulated=self.emulated)

    def poses(self, message: bytes) -> tuple[Pose | None, ...]:
        """Return the pose of each robot in a frame.

        The pose is None for a robot whose body is missing.
        """
        frame = json.loads(message)
        self._streamed_names = list(frame["bodies"])
        self.emulated = "emulated" in frame
        return tuple(
            self._convert_pose(frame["bodies"].get(str(robot.body)), robot.heading_offset)
            for robot in self.robots
        )

    def _convert_pose(
        self, position_and_quaternion: list[float] | None, heading_offset: float
    ) -> Pose | None:
        """Convert a body's position and quaternion to a pose.

        Args:
            position_and_quaternion: Position [m] and quaternion x, y, z, w of the rigid body. None
                if the body is not in the frame.
            heading_offset: Angle to add to the heading [rad].

        Returns:
            The pose. None if the body is not in the frame.
        """
        if position_and_quaternion is None:
            return None
        x, y, z, *quaternion = position_and_quaternion
        quaternion_x, quaternion_y, quaternion_z, quaternion_w = quaternion
        return self._placement.pose(
            RigidBody(0, (x, y, z), (quaternion_x, quaternion_y, quaternion_z, quaternion_w), True),
            self._up_axis,
            heading_offset,
        )
