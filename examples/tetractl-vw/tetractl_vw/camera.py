"""`camera: {type: json-poses}`: a program that sends a line of JSON for each picture, by UDP."""

import json
from typing import ClassVar, Literal

from pydantic import Field

from tetractl.core.poses import Pose
from tetractl.lab.cameras.port_camera import PortCamera
from tetractl.spec.lab_section import CameraSection


class JsonPosesSection(CameraSection):
    """`{"robots": {"red": [x, y, heading]}}` in mm and rad; null, or left out, if not tracked."""

    device: ClassVar[str] = "tetractl_vw.camera:JsonPoses"
    type: Literal["json-poses"]
    address: str = "udp://127.0.0.1:9800"
    """Where the camera's program waits to be asked, or udp://:PORT if it sends there unasked."""
    latency: float = Field(default=0.01, ge=0, le=0.5)
    """Time from the exposure of a picture until its line arrives [s]."""


class JsonPoses(PortCamera):
    """Poses of robots by their names."""

    def poses(self, message):
        """Return the pose of each robot in the spec's length unit, None if it is not tracked."""
        line, mm = json.loads(message), self.setup.metres * 1000
        seen = [line["robots"].get(name) for name in self.setup.names]
        poses = tuple(p and Pose(p[0] / mm, p[1] / mm, p[2]) for p in seen)
        self.emulated = "emulated" in line
        return poses
