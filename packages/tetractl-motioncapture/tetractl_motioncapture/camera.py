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
        self._bodies: list[str] = []
        self._up_axis = UpAxis.Z if section.up_axis == "z" else UpAxis.Y
        self._placement = Placement(*section.origin, section.rotation, 1.0 / setup.metres)
        super().__init__(section, setup, clock, wake, ports)

    def port(self, *arguments: Any) -> SerialPort:
        """Create the port to the library's process."""
        section = self.section
        name = json.dumps([section.system, section.hostname, section.options])
        return ProcessPort(name, *arguments[1:])

    def check(self) -> Health:
        """Report each robot whose rigid body is missing from the stream."""
        untracked = [robot for robot in self.robots if str(robot.body) not in self._bodies]
        streamed = ", ".join(printable(name, NAME_MAX) for name in self._bodies[:NAMES_MAX])
        unlisted = len(self._bodies) - NAMES_MAX
        streamed = (
            f"{streamed or 'none'} and {unlisted} more" if unlisted > 0 else streamed or "none"
        )
        lines = [
            f"the system streams no rigid body {o.body} for {o.name}; it streams {streamed}"
            for o in untracked
        ]
        return Health(tuple(lines), emulated=self.emulated)

    def poses(self, message: bytes) -> tuple[Pose | None, ...]:
        """Return the pose of each robot in a frame.

        The pose is None for a robot whose body is missing.
        """
        line = json.loads(message)
        self._bodies = list(line["bodies"])
        self.emulated = "emulated" in line
        return tuple(
            self._convert_pose(line["bodies"].get(str(o.body)), o.heading_offset)
            for o in self.robots
        )

    def _convert_pose(self, body: list[float] | None, offset: float) -> Pose | None:
        """Convert a body's position and quaternion to a pose.

        Args:
            body: Position [m] and quaternion x, y, z, w. None if the body is not in the frame.
            offset: Angle to add to the heading [rad].

        Returns:
            The pose. None if the body is not in the frame.
        """
        if body is None:
            return None
        x, y, z, *quaternion = body
        qx, qy, qz, qw = quaternion
        return self._placement.pose(
            RigidBody(0, (x, y, z), (qx, qy, qz, qw), True), self._up_axis, offset
        )
