"""`camera: {type: json-poses}`: a program that sends a line of JSON for each picture, by UDP."""

import json
from typing import ClassVar, Literal

from pydantic import Field

from tetractl.core.poses import Pose
from tetractl.experiment.lab_section import CameraSection
from tetractl.lab.cameras.port_camera import PortCamera
from tetractl.lab.udp_port import open_port


class JsonPosesSection(CameraSection):
    """`{"robots": {"red": [x, y, heading]}}` in mm and rad; null, or left out, if not tracked."""

    device: ClassVar[str] = "tetractl_vw.camera:JsonPoses"
    type: Literal["json-poses"]
    address: str = "udp://127.0.0.1:9800"
    latency: float = Field(default=0.01, ge=0, le=0.5)
    """Time from the exposure of a picture until its line arrives [s]."""


class JsonPoses(PortCamera):
    """Poses of robots by their names. `ports` makes another port, such as one in memory."""

    def __init__(self, section, setup, clock, wake=lambda: None, ports=None):
        self._names, self._unit = setup.names, setup.metres * 1000
        ports, count = ports or open_port, len(setup.names)
        super().__init__(count, section.address, section.latency, clock, wake, ports)

    def poses(self, message):
        """Return the pose of each robot, None if it is not tracked."""
        line = json.loads(message)
        seen = [line["robots"].get(name) for name in self._names]
        poses = tuple(p and Pose(p[0] / self._unit, p[1] / self._unit, p[2]) for p in seen)
        self.emulated = "emulated" in line
        return poses
