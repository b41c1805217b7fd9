"""The emulated camera of type `motioncapture`: it sends the same lines as `bridge`."""

import json
from collections.abc import Sequence
from typing import ClassVar

from tetractl_emulator.fault_rows import FaultRow
from tetractl_emulator.faults import Fault, fault_kind
from tetractl_emulator.optitrack.tracked_body import View
from tetractl_emulator.pose_stream import PoseSettings, PoseStream, Shot
from tetractl_emulator.sides import Body, Stage

from tetractl.core.errors import UsageError
from tetractl.lab.cameras.optitrack.natnet import UpAxis
from tetractl.lab.udp_port import SCHEME
from tetractl.spec.lab_section import entry
from tetractl_motioncapture.section import MotionCaptureSection


class EmulatedMotionCapture(PoseStream):
    """An emulated motion-capture system that streams the rigid bodies of the emulated robots.

    Each body has a position [m] and a quaternion, in the axes of the motion-capture system.

    Args:
        stage: The data and functions that the lab's emulated devices share.
        settings: The settings of the camera.
        bodies: The bodies that the camera sees.
    """

    faults: ClassVar[Sequence[type[Fault]]] = (
        *PoseStream.faults,
        fault_kind(
            "process_ends",
            "The process that runs the motion-capture library stops.",
            rows=[FaultRow("capture ends", "the camera", at_once=True)],
            begin=lambda fault, device: device.port.unplug(),
        ),
    )

    def __init__(self, stage: Stage, settings: PoseSettings, bodies: Sequence[Body]) -> None:
        section = stage.lab.camera
        assert isinstance(section, MotionCaptureSection), "the camera's type is motioncapture"
        if stage.wires.ports is None and not section.hostname.startswith(SCHEME):
            raise UsageError(
                f"the device at {section.hostname} cannot be emulated over a network",
                hint=(
                    f"give --set lab.camera.hostname={SCHEME}127.0.0.1:9800 both here and "
                    "to the run"
                ),
            )
        super().__init__(stage, settings, bodies)
        up = UpAxis.Z if section.up_axis == "z" else UpAxis.Y
        x, y = section.origin
        self.view = View(up, (x * stage.mm, y * stage.mm), section.rotation)
        robots = [entry(section.robots, body.name) for body in bodies]
        self._names = [str(robot.body) for robot in robots]
        for body, robot in zip(self.tracked, robots, strict=True):
            body.asset.heading_offset = robot.heading_offset

    def packed(self, shot: Shot) -> bytes:
        """Encode a frame as a line of JSON. Untracked bodies are left out."""
        poses = {
            self._names[body.id]: [*body.position, *body.quaternion]
            for body in shot.bodies
            if body.tracking_valid
        }
        return json.dumps({"emulated": True, "bodies": poses}).encode()
