"""Cameras and actuators by type, each before robots that it can see or move, for the contracts.

All but the AprilTag camera, which draws and searches pictures in threads of its own, are in virtual
time. A further type joins by an entry in `CAMERAS` or `ACTUATORS`.
"""

import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from support.emulated_lab import APRILTAG_SPEC, FIELD_SPEC, SPEC, emulated, in_virtual_time
from support.labs import STEP_NS, FakeActuator, FakeCamera, World

from tetractl.core.clock import Clock, MonotonicClock, wait_for
from tetractl.core.protocols import Actuator, Camera
from tetractl.core.setup import Setup
from tetractl.emulate.virtual_wires import LabClock
from tetractl.experiment.load import parse_spec

PATIENCE_S = 120.0  # before a test gives up; nothing waits for it to pass


@dataclass
class CameraRig:
    """A camera, not entered yet, and what can be done to what it sees; poses (N, 3) are true."""

    camera: Camera
    clock: Clock
    setup: Setup
    poses: Callable[[], np.ndarray]
    hide: Callable[[str], None]
    woken: Callable[[], int]

    def wait(self, condition: Callable[[], bool]) -> bool:
        """Let time pass until a condition holds."""
        return wait_for(self.clock, condition, PATIENCE_S)


@dataclass
class ActuatorRig:
    """An actuator, not entered yet, and what it moves; `moves()` (N,) tells who truly moves."""

    actuator: Actuator
    clock: Clock
    setup: Setup
    moves: Callable[[], list[bool]]
    unplug: Callable[[], None]

    def wait(self, condition: Callable[[], bool]) -> bool:
        """Let time pass until a condition holds."""
        return wait_for(self.clock, condition, PATIENCE_S)


@contextmanager
def fake_camera(folder: Path) -> Iterator[CameraRig]:
    setup = parse_spec(SPEC, "fake").experiment.setup
    clock = LabClock(STEP_NS)
    camera = FakeCamera(World(setup, clock))
    yield CameraRig(
        camera,
        clock,
        setup,
        lambda: camera.world.poses,
        camera.hidden.add,
        lambda: 0 if camera.newest is None else camera.newest.number,
    )


@contextmanager
def fake_actuator(folder: Path) -> Iterator[ActuatorRig]:
    setup = parse_spec(SPEC, "fake").experiment.setup
    clock = LabClock(STEP_NS)
    actuator = FakeActuator(World(setup, clock))

    def unplug() -> None:
        actuator.failure = "gone"

    yield ActuatorRig(actuator, clock, setup, lambda: list(actuator.world.moving), unplug)


@contextmanager
def running(folder: Path, spec: str = SPEC) -> Iterator:
    """An emulated lab in virtual time, the experiment that leads to it, and the clock."""
    with in_virtual_time(folder, spec=spec) as (lab, clock, settings):
        yield lab, parse_spec(spec, "emulated", settings).experiment, clock


@contextmanager
def optitrack(folder: Path) -> Iterator[CameraRig]:
    woken = []
    with running(folder) as (lab, experiment, clock):
        camera = experiment.lab.camera.build(experiment.setup, clock, lambda: woken.append(1))

        def hide(name: str) -> None:
            lab.camera.tracked_body(name).tracked = False

        yield CameraRig(camera, clock, experiment.setup, _poses(lab), hide, lambda: len(woken))
        camera.__exit__(None, None, None)


@contextmanager
def _actuator(folder: Path, spec: str) -> Iterator[ActuatorRig]:
    with running(folder, spec) as (lab, experiment, clock):
        actuator = experiment.lab.actuator.build(experiment.setup, clock)

        def moves() -> list[bool]:
            return [not body.standing for body in lab.actuator.bodies]

        yield ActuatorRig(
            actuator, clock, experiment.setup, moves, lambda: lab.actuator.plugged(False)
        )
        actuator.__exit__(None, None, None)


@contextmanager
def apriltag(folder: Path) -> Iterator[CameraRig]:
    pytest.importorskip("cv2")
    clock, woken = MonotonicClock(), []
    with emulated(folder, spec=APRILTAG_SPEC) as lab:
        thread = threading.Thread(target=lab.run)
        thread.start()
        experiment = parse_spec(APRILTAG_SPEC, "emulated").experiment
        source = experiment.lab.camera.source.model_copy(update={"url": lab.camera.camera.url})
        section = experiment.lab.camera.model_copy(update={"source": source, "connect": PATIENCE_S})
        camera = section.build(experiment.setup, clock, lambda: woken.append(1))

        def hide(name: str) -> None:
            lab.camera.renderer.hidden.add(lab.camera.tag(name))

        try:
            yield CameraRig(camera, clock, experiment.setup, _poses(lab), hide, lambda: len(woken))
            camera.__exit__(None, None, None)
        finally:
            lab.loop.end()
            thread.join()


def _poses(lab) -> Callable[[], np.ndarray]:
    return lambda: np.array([(b.x, b.y, b.heading) for b in lab.actuator.bodies])


CAMERAS: dict[str, Callable[[Path], AbstractContextManager[CameraRig]]] = {
    "fake": fake_camera,
    "optitrack": optitrack,
    "apriltag": apriltag,
}
ACTUATORS: dict[str, Callable[[Path], AbstractContextManager[ActuatorRig]]] = {
    "fake": fake_actuator,
    "m3pi-xbee": lambda folder: _actuator(folder, SPEC),
    "field": lambda folder: _actuator(folder, FIELD_SPEC),
}
