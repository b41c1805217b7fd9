"""Tests that a good camera and actuator pass all checks, and that each fault fails its check."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from testkit.labs import FakeActuator, FakeCamera, SteppedClock, World
from testkit.trials import experiment
from tetractl_testing import device_checks
from tetractl_testing.device_checks import MovedRobots, SeenRobots, check_actuator, check_camera
from tetractl_testing.expect import findings_of

from tetractl.core.clock import SECOND
from tetractl.core.commands import Steer, Turn
from tetractl.core.errors import AbortError
from tetractl.core.protocols import Health

SETUP = experiment().setup
MM = 1 / (1000 * SETUP.metres)
"""Length units of a millimetre."""


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    """Devices in virtual time do what they shall at once, or never."""
    monkeypatch.setattr(device_checks, "EMULATED_TIMEOUT_S", 0.3)


def problems(check, *args):
    return [finding.what for finding in findings_of(partial(check, *args)) if finding.problem]


class Camera(FakeCamera):
    """A camera of the lab in virtual time, with a fault that changes its frames."""

    def __init__(self, world, wake, fault):
        super().__init__(world)
        self.wake = wake
        self.fault = fault
        self.left = False

    def frames(self):
        frames = [self.fault.get("frame", lambda frame: frame)(frame) for frame in super().frames()]
        for _ in frames[self.fault.get("silent", 0) :]:
            self.wake()
        if self.left and "goes_on" not in self.fault:
            return []
        return frames

    def check(self):
        return self.fault.get("health", Health())

    def __enter__(self):
        entered = super().__enter__()
        return self.fault.get("enters", entered)

    def __exit__(self, *error):
        if "leaves" in self.fault and self.left:
            raise RuntimeError("closed twice")
        self.left = True
        if "goes_on" not in self.fault:
            super().__exit__(*error)


def camera_problems(**fault):
    clock = SteppedClock()
    world = World(SETUP, clock)
    cameras = []

    def build(setup, clock, wake):
        cameras.append(Camera(world, wake, fault))
        cameras[-1].damaged = fault.get("damaged", 0)
        return cameras[-1]

    def hide(name):
        if "unhidden" not in fault:
            cameras[0].hidden.add(name)
        if "hides_all" in fault:
            cameras[0].hidden.update(SETUP.names)

    scene = SeenRobots(clock, lambda: world.poses, hide)
    return problems(check_camera, SimpleNamespace(build=build), SETUP, scene)


def with_pose(**changes):
    """A fault of the first robot's pose in every frame."""

    def frame(frame):
        first, *others = frame.poses
        if first is None:
            return frame
        moved = {name: getattr(first, name) + by for name, by in changes.items() if name in "xy"}
        turned = {"heading": first.heading + changes.get("heading", 0.0)}
        stands = {name: value for name, value in changes.items() if name in ("height", "tilt")}
        return replace(frame, poses=(replace(first, **moved, **turned, **stands), *others))

    return {"frame": frame}


def test_a_good_camera_has_no_problem():
    assert camera_problems() == []


@pytest.mark.parametrize(
    "good",
    [
        with_pose(x=4.0 * MM),
        with_pose(heading=0.04),
        with_pose(heading=2 * np.pi),
        with_pose(height=100.0 * MM, tilt=0.1),
    ],
)
def test_small_errors_of_poses_are_no_problem(good):
    assert camera_problems(**good) == []


@pytest.mark.parametrize(
    ("fault", "what"),
    [
        ({"frame": lambda frame: replace(frame, number=1)}, "frames: numbers rise"),
        (
            {"frame": lambda frame: replace(frame, sampled_ns=1000 - frame.number)},
            "frames: times rise",
        ),
        (
            {"frame": lambda frame: replace(frame, received_ns=frame.sampled_ns - 1)},
            "frames: are received after their exposure",
        ),
        (
            {"frame": lambda frame: replace(frame, received_ns=frame.received_ns + SECOND)},
            "frames: are received after their exposure",
        ),
        (
            {"frame": lambda frame: replace(frame, poses=frame.poses[1:])},
            "frames: have one pose per",
        ),
        ({"silent": 99}, "wake: is called after each frame"),
        ({"damaged": 2}, "damaged: 0"),
        ({"frame": lambda frame: replace(frame, fault="cut")}, "frames: have no faults and"),
        (with_pose(x=6.0 * MM), "poses: are in the spec's coordinates"),
        (with_pose(y=-6.0 * MM), "poses: are in the spec's coordinates"),
        (with_pose(heading=0.06), "poses: have the headings of the robots"),
        (with_pose(heading=-0.06), "poses: have the headings of the robots"),
        (with_pose(height=120.0 * MM, tilt=0.0), "poses: have the height of the body on the floor"),
        (with_pose(height=60.0 * MM, tilt=0.3), "poses: have the tilt of a robot on the floor"),
        ({"unhidden": True}, "poses: are None for a robot that is out of sight"),
        ({"hides_all": True}, "poses: the other robots are still tracked"),
        ({"health": Health(problems=("dirty",))}, "check: no problems"),
        ({"health": Health(facts={"rate": 3})}, "check: returns facts that are strings"),
        ({"enters": None}, "__enter__: returns the camera"),
        ({"goes_on": True}, "__exit__: no frame comes afterwards"),
        ({"leaves": True}, "__exit__: can be called again, and before __enter__"),
    ],
)
def test_a_fault_of_a_camera_is_found(fault, what):
    assert any(found.startswith(what) for found in camera_problems(**fault))


class Actuator(FakeActuator):
    """An actuator of the lab in virtual time, whose transmissions a fault changes."""

    fault = {}  # noqa: RUF012 replaced by each test
    gone = False

    def send(self, action, poses, moving, exposed_ns):
        if self.gone and "unnoticed" not in self.fault:
            self.failure = "unplugged"
            raise AbortError("unplugged")
        if isinstance(action, Turn) and "cannot_turn" in self.fault:
            raise AbortError("no")
        sent = super().send(action, poses, moving, exposed_ns)
        return self.fault.get("sent", lambda sent: sent)(sent)

    def stop(self, emergency=False):
        if self.gone and "stops_on" not in self.fault:
            raise AbortError("unplugged")
        self.failure, failure = None, self.failure
        sent = super().stop(emergency)
        self.failure = failure
        if "rolls_on" in self.fault:
            self.world.moving = (True,) * len(self.world.moving)
        return self.fault.get("stopped", lambda sent: sent)(sent)

    def poll(self, timeout_s):
        return super().poll(timeout_s)[self.fault.get("unanswered", 0) :]

    def check(self):
        return self.fault.get("health", Health())


def actuator_problems(halts=True, contradictions=(), **fault):
    clock = SteppedClock()
    world = World(SETUP, clock)
    clock.steps.append(world.advance)
    actuators = []

    def build(setup, clock):
        actuators.append(Actuator(world, halts=halts, **fault.get("members", {})))
        actuators[-1].fault = fault
        return actuators[-1]

    def unplug():
        actuators[0].gone = True

    section = SimpleNamespace(
        build=build,
        contradictions=lambda setup: contradictions,
        checks="tetractl.lab.guard_checks:robot_checks",
    )
    moves = fault.get("moves", lambda world: world.moving)
    robots = MovedRobots(clock, lambda: moves(world), unplug)
    return problems(check_actuator, section, SETUP, robots)


def test_a_good_actuator_has_no_problem():
    assert actuator_problems() == []


def steered(**changes):
    """A fault of what is said of a direction that was sent."""

    def sent(sent):
        if not isinstance(sent.action, Steer):
            return sent
        values = {name: change(getattr(sent, name)) for name, change in changes.items()}
        return replace(sent, **values)

    return {"sent": sent}


def turned(**changes):
    def sent(sent):
        if not isinstance(sent.action, Turn):
            return sent
        return replace(
            sent, **{name: change(getattr(sent, name)) for name, change in changes.items()}
        )

    return {"sent": sent}


@pytest.mark.parametrize(
    "good",
    [
        steered(speed=lambda speed: 1.08 * speed),
        steered(turning=lambda turning: 1.15 * turning),
        steered(sent_ns=lambda sent_ns: sent_ns - SECOND // 2),
    ],
)
def test_small_errors_of_an_actuator_are_no_problem(good):
    assert actuator_problems(**good) == []


@pytest.mark.parametrize(
    ("fault", "what"),
    [
        ({"contradictions": [(("rate",), "is too low")]}, "section: fits the spec's robots"),
        ({"members": {"period_ns": 0}}, "period_ns: above 0"),
        ({"members": {"failure": "old"}}, "failure: is None before the device is opened"),
        ({"unanswered": 1}, "poll: returns a status of each robot, without problems"),
        ({"health": Health(problems=("low",))}, "check: no problems"),
        ({"moves": lambda world: (True,) * len(world.moving)}, "poll, check: move no robot"),
        ({"moves": lambda world: (False,) * len(world.moving)}, "steer: moves the robots"),
        (steered(speed=lambda speed: 1.2 * speed), "steer: states the speeds of the spec"),
        (steered(speed=lambda speed: 0.8 * speed), "steer: states the speeds of the spec"),
        (steered(turning=lambda turning: 1.3 * turning), "steer: turns the robots towards"),
        (steered(turning=lambda turning: -turning), "steer: turns the robots towards"),
        (steered(sent_ns=lambda sent_ns: sent_ns + SECOND), "steer: is sent at once"),
        (steered(sent_ns=lambda sent_ns: sent_ns - 2 * SECOND), "steer: is sent at once"),
        (steered(action=lambda action: Steer(0.0)), "steer: action, robots"),
        (steered(delivered=lambda delivered: (False, *delivered[1:])), "steer: action, robots"),
        (
            steered(left=lambda _: np.zeros(1)),
            "steer: states wheels of shape (N,) or None, and outputs that are numbers",
        ),
        (
            steered(outputs=lambda _: {"a": "1"}),
            "steer: states wheels of shape (N,) or None, and outputs that are numbers",
        ),
        (
            {"stopped": lambda sent: replace(sent, action=Turn(0.0))},
            "stop: reports that it stops the robots",
        ),
        ({"stopped": lambda sent: replace(sent, speed=sent.speed + 1)}, "stop: robots stand still"),
        ({"rolls_on": True}, "stop: robots stand still"),
        ({"cannot_turn": True}, "turn: only for robots that can stand still"),
        (turned(speed=lambda _: SETUP.speed), "turn: turns robots on the spot"),
        (turned(turning=lambda turning: -turning), "turn: turns robots towards the direction"),
        ({"unnoticed": True}, "failure: reports a device that is gone"),
        ({"stops_on": True}, "stop: raises AbortError when the device is gone"),
    ],
)
def test_a_fault_of_an_actuator_is_found(fault, what):
    assert any(found.startswith(what) for found in actuator_problems(**fault))


def test_robots_that_cannot_halt_need_not_turn_on_the_spot():
    assert actuator_problems(halts=False, moves=lambda world: (True,) * len(world.moving)) == [
        "poll, check: move no robot",
        "moving: holds one robot while the others move",
    ]
