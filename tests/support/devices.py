"""Cameras and actuators by type, each before robots that it can see or move, for the contracts.

All but the AprilTag camera, which draws and searches pictures in threads of its own, are in virtual
time. A further type joins by an entry in `CAMERAS` or `ACTUATORS`.
"""

import threading
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest
from support.emulated_lab import APRILTAG_SPEC, FIELD_SPEC, SPEC, emulated, in_virtual_time
from support.labs import STEP_NS, FakeActuator, FakeCamera, World

from tetractl.core.clock import MonotonicClock
from tetractl.emulate.virtual_wires import LabClock
from tetractl.experiment.load import parse_spec
from tetractl.testing import MovedRobots, SeenRobots


def fake_world():
    setup = parse_spec(SPEC, "fake").experiment.setup
    return setup, World(setup, LabClock(STEP_NS))


@contextmanager
def fake_camera(folder):
    setup, world = fake_world()
    cameras = []

    def build(setup, clock, wake):
        cameras.append(FakeCamera(world, wake))
        return cameras[-1]

    scene = SeenRobots(world.clock, lambda: world.poses, lambda name: cameras[0].hidden.add(name))
    yield SimpleNamespace(build=build), setup, scene


@contextmanager
def fake_actuator(folder):
    setup, world = fake_world()
    actuators = []

    def build(setup, clock):
        actuators.append(FakeActuator(world))
        return actuators[-1]

    def unplug():
        actuators[0].failure = "gone"

    section = SimpleNamespace(build=build, contradictions=lambda setup: ())
    yield section, setup, MovedRobots(world.clock, lambda: list(world.moving), unplug)


@contextmanager
def running(folder, spec=SPEC):
    """An emulated lab in virtual time, the experiment that leads to it, and the clock."""
    with in_virtual_time(folder, spec=spec) as (lab, clock, settings):
        yield lab, parse_spec(spec, "emulated", settings).experiment, clock


@contextmanager
def optitrack(folder):
    with running(folder) as (lab, experiment, clock):

        def hide(name):
            lab.camera.tracked_body(name).tracked = False

        yield experiment.lab.camera, experiment.setup, SeenRobots(clock, poses(lab), hide)


@contextmanager
def actuator(folder, spec):
    with running(folder, spec) as (lab, experiment, clock):

        def moves():
            return [not body.standing for body in lab.actuator.bodies]

        robots = MovedRobots(clock, moves, lambda: lab.actuator.plugged(False))
        yield experiment.lab.actuator, experiment.setup, robots


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
            lab.camera.renderer.hidden.add(lab.camera.tag(name))

        try:
            yield section, experiment.setup, SeenRobots(MonotonicClock(), poses(lab), hide)
        finally:
            lab.loop.end()
            thread.join()


def poses(lab):
    return lambda: np.array([(b.x, b.y, b.heading) for b in lab.actuator.bodies])


CAMERAS = {"fake": fake_camera, "optitrack": optitrack, "apriltag": apriltag}
ACTUATORS = {
    "fake": fake_actuator,
    "m3pi-xbee": lambda folder: actuator(folder, SPEC),
    "field": lambda folder: actuator(folder, FIELD_SPEC),
}
