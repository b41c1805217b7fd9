"""Tests that cameras and actuators of a lab pass the checks of `tetractl_testing`.

The robots are emulated, in virtual time. The exception is the AprilTag camera, which draws and
searches images in threads of its own.
"""

import threading
from contextlib import contextmanager

import numpy as np
import pytest
from testkit.emulator.acting import act
from testkit.emulator.device_specs import APRILTAG_SPEC, FIELD_SPEC, TWIST_SPEC
from testkit.emulator.lab_processes import emulated
from testkit.emulator.virtual_lab import virtual_lab
from testkit.lab_specs import SPEC
from tetractl_testing import MovedRobots, SeenRobots, check_actuator, check_camera

from tetractl.core.clock import MonotonicClock
from tetractl.spec.load import parse_spec

pytestmark = pytest.mark.slow


@contextmanager
def optitrack(folder):
    with virtual_lab(folder) as lab:

        def hide(name):
            act(lab.emulation.camera.acting, "untracked", robot=name, subject=name)

        scene = SeenRobots(lab.clock, poses(lab.emulation), hide)
        yield lab.spec.experiment.plant.camera, lab.spec.experiment.setup, scene


@contextmanager
def actuator(folder, spec):
    with virtual_lab(folder, spec=spec) as lab:

        def moves():
            return [not body.standing for body in lab.robots]

        robots = MovedRobots(lab.clock, moves, lambda: lab.emulation.actuator.set_plugged(False))
        yield lab.spec.experiment.plant.actuator, lab.spec.experiment.setup, robots


@contextmanager
def apriltag(folder):
    pytest.importorskip("cv2")
    with emulated(folder, spec=APRILTAG_SPEC) as lab:
        thread = threading.Thread(target=lab.run)
        thread.start()
        experiment = parse_spec(APRILTAG_SPEC, "emulated").experiment
        source = experiment.lab.camera.source.model_copy(update={"url": lab.camera.camera.url})
        section = experiment.lab.camera.model_copy(update={"source": source, "connect": 120.0})

        def hide(name):
            act(lab.injector.acting, "untracked", robot=name, subject=name)

        try:
            yield section, experiment.setup, SeenRobots(MonotonicClock(), poses(lab), hide)
        finally:
            lab.loop.end()
            thread.join()


def poses(lab):
    return lambda: np.array([(b.x, b.y, b.heading) for b in lab.actuator.bodies])


CAMERAS = {"optitrack": optitrack, "apriltag": apriltag}
ACTUATORS = {
    "m3pi-xbee": lambda folder: actuator(folder, SPEC),
    "field": lambda folder: actuator(folder, FIELD_SPEC),
    "twist": lambda folder: actuator(folder, TWIST_SPEC),
}


@pytest.mark.long
@pytest.mark.parametrize("name", CAMERAS)
def test_camera(name, tmp_path):
    with CAMERAS[name](tmp_path) as (section, setup, scene):
        check_camera(section, setup, scene)


@pytest.mark.parametrize("name", ACTUATORS)
def test_actuator(name, tmp_path):
    with ACTUATORS[name](tmp_path) as (section, setup, robots):
        check_actuator(section, setup, robots)
