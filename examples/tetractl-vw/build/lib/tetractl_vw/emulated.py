"""The emulated sides: what camera and robots do at the other end of the wires."""

import json

from tetractl_emulator.pose_stream import PoseStream
from tetractl_emulator.twist.own_lines import OwnLines


class EmulatedJsonPoses(PoseStream):
    """The camera: a line for each picture."""

    def packed(self, shot):
        """Return the line of a picture, whose poses are in metres."""
        seen = ((i, p and [p.x * 1000, p.y * 1000, p.heading]) for i, p in shot.poses.items())
        robots = {self.names[i]: pose for i, pose in seen}
        return json.dumps({"emulated": True, "robots": robots}).encode()


class EmulatedVw(OwnLines):
    """The robots: what a line asks of the wheels."""

    def read(self, message, row):
        """Return the wheel speeds [mm/s] for a line."""
        v, w = map(float, message.split())
        rim = w * self.radii[row]
        return round(1000 * v - rim), round(1000 * v + rim)
