"""Runs the checks of `tetractl_testing` on a camera and an actuator that can be emulated.

Everything runs in virtual time.
"""

from functools import partial

import numpy as np
from tetractl_testing import MovedRobots, SeenRobots, check_actuator, check_camera

from tetractl.core.poses import Floats
from tetractl.core.setup import Setup
from tetractl.lab.serial_port import is_network
from tetractl.spec.lab_section import LabSection
from tetractl_emulator.m3pi.wheeled_side import PortedSide
from tetractl_emulator.pose_stream import PoseStream
from tetractl_emulator.sides import Options
from tetractl_emulator.virtual_lab import LabClock, start_emulated_lab


def check_lab(lab: LabSection, setup: Setup) -> None:
    """Check a camera and an actuator against their emulated counterparts.

    Args:
        lab: The lab. Its camera must be emulated by a `PoseStream`, and its actuator by a
            `PortedSide`, such as `OwnLines`.
        setup: The constants of the experiment.

    Raises:
        AssertionError: If a check fails, or if a device is emulated by another class.
    """
    clock = LabClock()
    emulation = start_emulated_lab(lab, setup, clock, Options(address=None))
    camera = emulation.camera
    actuator = emulation.actuator
    assert isinstance(camera, PoseStream), "the camera's emulated side is a PoseStream"
    assert isinstance(actuator, PortedSide), "the actuator's emulated side is a PortedSide"

    def poses() -> Floats:
        bodies = [(body.x / stage_mm, body.y / stage_mm, body.heading) for body in actuator.bodies]
        return np.array(bodies)

    def hide(name: str) -> None:
        (untracked,) = (kind for kind in camera.faults if kind.__name__ == "untracked")
        emulation.injector.act(untracked.model_validate({"fault": "untracked", "robot": name}))

    def moves() -> list[bool]:
        return [not body.standing for body in actuator.bodies]

    stage_mm = setup.metres * 1000
    ports = emulation.wires.ports
    unplug = None  # a robot that is gone from a network is not noticed
    if not all(is_network(radio.port.name) for radio in actuator.radios):
        unplug = partial(actuator.set_plugged, False)
    try:
        check_camera(lab.camera, setup, SeenRobots(clock, poses, hide, ports))
        check_actuator(lab.actuator, setup, MovedRobots(clock, moves, unplug, ports))
    finally:
        emulation.close()
