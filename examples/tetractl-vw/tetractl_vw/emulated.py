"""The emulated sides: what camera and robots do at the other end of the wires."""

import json

from tetractl_emulator.pose_stream import PoseStream
from tetractl_emulator.twist.own_lines import OwnLines


class EmulatedJsonPoses(PoseStream):
    """The camera: a line for each picture."""

    def __init__(self, stage, settings, bodies):
        super().__init__(stage, settings, bodies, stage.lab.camera.address)

    def packed(self, shot):
        """Return the line of a picture."""
        seen = ((i, p and [p.x * 1000, p.y * 1000, p.heading]) for i, p in shot.poses.items())
        robots = {self.names[i]: pose for i, pose in seen}
        return json.dumps({"emulated": True, "robots": robots}).encode()


class EmulatedVw(OwnLines):
    """The robots: what a line asks of the wheels."""

    def __init__(self, stage, settings):
        section = stage.lab.actuator
        address = {robot.name: robot.address for robot in section.robots}
        ports = [address[name] for name in stage.setup.names]
        super().__init__(stage, settings, ports, section.speed_max_mm_s)

    def read(self, line, row):
        """Return the wheel speeds [mm/s] for a line."""
        v, w = map(float, line.split())
        rim = w * self.radii[row]
        return round(1000 * v - rim), round(1000 * v + rim)
