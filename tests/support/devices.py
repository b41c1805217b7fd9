"""Cameras and actuators by type, each before robots that it can see or move, for the contracts.

A further type joins by an entry in `CAMERAS` or `ACTUATORS`.
"""

import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from support.emulated_lab import APRILTAG_SPEC, FIELD_SPEC, SPEC, emulated
from support.labs import STEP_NS, FakeActuator, FakeCamera, SteppedClock, World

from tetractl.core.clock import SECOND, Clock, MonotonicClock
from tetractl.core.protocols import Actuator, Camera
from tetractl.core.setup import Setup
from tetractl.experiment.load import parse_spec

PATIENCE_S = 10


@dataclass
class CameraRig:
    """A camera, not entered yet, and what can be done to what it sees; poses (N, 3) are true."""

    camera: Camera
    clock: Clock
    setup: Setup
    poses: Callable[[], np.ndarray]
    hide: Callable[[str], None]
    wait: Callable[[Callable[[], bool]], bool]  # let time pass until a condition holds
    woken: Callable[[], int]


@dataclass
class ActuatorRig:
    """An actuator, not entered yet, and what it moves; `moves()` (N,) tells who truly moves."""

    actuator: Actuator
    clock: Clock
    setup: Setup
    moves: Callable[[], list[bool]]
    wait: Callable[[Callable[[], bool]], bool]
    unplug: Callable[[], None]


def _stepped(clock: SteppedClock) -> Callable[[Callable[[], bool]], bool]:
    def wait(condition: Callable[[], bool]) -> bool:
        end = clock.now() + PATIENCE_S * SECOND
        while not condition() and clock.now() < end:
            clock.sleep_until(clock.now() + STEP_NS)
        return condition()

    return wait


def _waiting(changed: threading.Event) -> Callable[[Callable[[], bool]], bool]:
    def wait(condition: Callable[[], bool]) -> bool:
        clock = MonotonicClock()
        while not condition() and clock.now() < PATIENCE_S * SECOND:
            changed.wait(0.005)
            changed.clear()
        return condition()

    return wait


@contextmanager
def fake_camera(folder: Path) -> Iterator[CameraRig]:
    setup = parse_spec(SPEC, "fake").experiment.setup
    clock = SteppedClock()
    camera = FakeCamera(World(setup, clock))
    yield CameraRig(
        camera,
        clock,
        setup,
        lambda: camera.world.poses,
        camera.hidden.add,
        _stepped(clock),
        lambda: 0 if camera.newest is None else camera.newest.number,
    )


@contextmanager
def fake_actuator(folder: Path) -> Iterator[ActuatorRig]:
    setup = parse_spec(SPEC, "fake").experiment.setup
    clock = SteppedClock()
    actuator = FakeActuator(World(setup, clock))

    def unplug() -> None:
        actuator.failure = "gone"

    moves = lambda: list(actuator.world.moving)  # noqa: E731
    yield ActuatorRig(actuator, clock, setup, moves, _stepped(clock), unplug)


@contextmanager
def running(folder: Path, spec: str = SPEC) -> Iterator:
    """An emulated lab that runs in a thread, and the experiment that leads to it."""
    with emulated(folder, spec=spec) as lab:
        settings = [f"lab.actuator.port={lab.actuator.port.link}"]
        if spec != APRILTAG_SPEC:
            settings.append(f"lab.camera.command_port={lab.camera.motive.command_port}")
        experiment = parse_spec(spec, "emulated", settings).experiment
        thread = threading.Thread(target=lab.run)
        thread.start()
        try:
            yield lab, experiment
        finally:
            lab.loop.end()
            thread.join()


@contextmanager
def optitrack(folder: Path) -> Iterator[CameraRig]:
    clock, changed, count = MonotonicClock(), threading.Event(), [0]

    def wake() -> None:
        count[0] += 1
        changed.set()

    with running(folder) as (lab, experiment):
        camera = experiment.lab.camera.build(experiment.setup, clock, wake)

        def hide(name: str) -> None:
            lab.camera.tracked_body(name).tracked = False

        def poses() -> np.ndarray:
            return np.array([(b.x, b.y, b.heading) for b in lab.actuator.bodies])

        yield CameraRig(
            camera, clock, experiment.setup, poses, hide, _waiting(changed), lambda: count[0]
        )
        camera.__exit__(None, None, None)


@contextmanager
def _actuator(folder: Path, spec: str) -> Iterator[ActuatorRig]:
    clock = MonotonicClock()
    with running(folder, spec) as (lab, experiment):
        actuator = experiment.lab.actuator.build(experiment.setup, clock)

        def moves() -> list[bool]:
            return [not body.standing for body in lab.actuator.bodies]

        def unplug() -> None:
            lab.timeline.at(0, lab.actuator.unplug)

        wait = _waiting(threading.Event())
        yield ActuatorRig(actuator, clock, experiment.setup, moves, wait, unplug)
        actuator.__exit__(None, None, None)


@contextmanager
def apriltag(folder: Path) -> Iterator[CameraRig]:
    pytest.importorskip("cv2")
    clock, changed, count = MonotonicClock(), threading.Event(), [0]

    def wake() -> None:
        count[0] += 1
        changed.set()

    with running(folder, APRILTAG_SPEC) as (lab, experiment):
        source = experiment.lab.camera.source.model_copy(update={"url": lab.camera.camera.url})
        section = experiment.lab.camera.model_copy(update={"source": source, "connect": 10.0})
        camera = section.build(experiment.setup, clock, wake)

        def hide(name: str) -> None:
            lab.camera.renderer.hidden.add(lab.camera.tag(name))

        def poses() -> np.ndarray:
            return np.array([(b.x, b.y, b.heading) for b in lab.actuator.bodies])

        yield CameraRig(
            camera, clock, experiment.setup, poses, hide, _waiting(changed), lambda: count[0]
        )
        camera.__exit__(None, None, None)


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
