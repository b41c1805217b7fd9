"""Tests of what `lab calibrate` refuses in advance, and of what it measures."""

import math
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest
from testkit.lab_specs import SPEC
from testkit.labs import FakeActuator, FakeCamera, SteppedClock, World

from tetractl.core.clock import SECOND
from tetractl.core.commands import Stop
from tetractl.core.errors import AbortError
from tetractl.core.protocols import LabSupervision
from tetractl.lab.actuators.wheel_commands import WheeledActuator
from tetractl.lab.calibrate import calibrate_robots
from tetractl.lab.rig import Rig
from tetractl.spec.load import parse_spec
from tetractl.spec.plants import on_plant


class SteeringActuator:
    """An actuator of which nothing says that its robots have wheels; it is never opened."""


def test_an_actuator_without_wheels_is_not_calibrated():
    """Regression: an assertion failed; under `python -O` the robots were driven at the spec's
    speed, whatever the limit."""
    experiment = on_plant(parse_spec(SPEC, "lab.yaml"), "lab").experiment
    lab = experiment.plant
    rig = SimpleNamespace(actuator=SteeringActuator())
    name = experiment.setup.names[0]
    arguments = lab, lambda limits, setup: rig, experiment.setup, [name], 45, print
    with pytest.raises(AbortError, match="SteeringActuator cannot be calibrated"):
        lab.actuator.calibrate(*arguments)


@dataclass
class HeldWheels(FakeActuator, WheeledActuator):
    """A robot's wheels, driven by the outputs that the calibration holds.

    A motor turns its wheel by `gains_mm` per output beyond its dead zone; `body` is the angle from
    the heading that the camera shows to the direction in which the robot drives forwards.
    """

    gains_mm: tuple[float, float] = (2.0, 2.0)
    dead_zones: tuple[int, int] = (0, 0)
    radius_mm: float = 40.0
    swap: bool = False
    body: float = 0.0
    sent_outputs: list = field(default_factory=list)

    def _drive(self, outputs):
        raise NotImplementedError

    def _halt(self, emergency):
        raise NotImplementedError

    def _send(self, action, moving):
        sent = super()._send(action, (False,) * len(moving))
        outputs = np.zeros(2) if isinstance(action, Stop) else self.held[:, 0] * 1.0
        self.sent_outputs.append(outputs)
        beyond = np.sign(outputs) * np.maximum(np.abs(outputs) - self.dead_zones, 0)
        motors = beyond * self.gains_mm
        left, right = reversed(motors) if self.swap else motors
        self.world.rolls = rolls = ((left + right) / 2, (right - left) / 2 / self.radius_mm)
        speeds = {"left": left, "right": right, "speed": rolls[0], "turning": rolls[1]}
        delivered = (True,) * len(moving)
        arrays = {name: np.array([float(value)]) for name, value in speeds.items()}
        return replace(sent, delivered=delivered, **arrays)


class RollingWorld(World):
    """The world of one robot that rolls with a speed [mm/s] and a turning rate [rad/s]."""

    rolls = (0.0, 0.0)
    body = 0.0

    def advance(self):
        seconds = (self.clock.now() - self.then_ns) / SECOND
        self.then_ns = self.clock.now()
        speed, rate = self.rolls
        heading = self.poses[0, 2]
        course = heading + self.body + rate * seconds / 2  # of the chord of a short arc
        way = speed / 1000 / self.setup.metres * seconds
        step = np.array([way * math.cos(course), way * math.sin(course), rate * seconds])
        self.poses = (self.poses[0] + step)[None]


class BoundedClock(SteppedClock):
    """Virtual time that ends: a robot is measured within half a minute."""

    def sleep_until(self, when):
        assert self.now() < 30 * SECOND
        super().sleep_until(min(when, 31 * SECOND))


class HeldSection:
    """What the section of such an actuator says: 127 outputs are full speed."""

    dead_zone_max = 50

    def outputs(self, name, limit):
        return 1.0, limit

    def measured(self, calibrated):
        return {"found": calibrated}


LIMIT = 26


def calibrated(**wheels):
    """Calibrate one robot with such wheels in virtual time; return what was found, and the lab."""
    spec = parse_spec(SPEC, "lab.yaml")
    lab = on_plant(spec, "lab").experiment.plant
    setup = on_plant(spec, "lab").experiment.setup
    rigs = []

    def make_rig(limits, one):
        clock = BoundedClock()
        world = RollingWorld(one, clock)
        world.body = wheels.get("body", 0.0)
        actuator = HeldWheels(world, **wheels)
        emergency = LabSupervision().emergency
        rig = Rig(FakeCamera(world), actuator, limits, one, clock, emergency, threaded=False)
        clock.steps.append(rig.loop.step)
        rigs.append(rig)
        return rig

    name = setup.names[0]
    measured = calibrate_robots(HeldSection(), lab, make_rig, setup, [name], LIMIT, print)
    (entry,) = measured.actuator["robots"]
    return entry["found"], rigs[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gains_mm", "dead_zones", "radius_mm", "body", "swap", "inverted"),
    [
        ((2.2, 1.8), (3, 1), 30.0, 0.4, True, (False, False)),
        ((-2.0, 2.5), (0, 2), 45.0, -0.6, False, (True, False)),
    ],
)
def test_a_calibration_finds_the_wheels_that_the_robot_has(
    gains_mm, dead_zones, radius_mm, body, swap, inverted
):
    found, rig = calibrated(
        gains_mm=gains_mm, dead_zones=dead_zones, radius_mm=radius_mm, body=body, swap=swap
    )
    wheels = list(zip(gains_mm, dead_zones, inverted, strict=True))
    left, right = reversed(wheels) if swap else wheels
    assert found.swap == swap
    assert found.radius_mm == pytest.approx(radius_mm, rel=0.01)
    assert found.heading_offset == pytest.approx(body, abs=0.01)
    for wheel, (gain_mm, dead_zone, is_inverted) in ((found.left, left), (found.right, right)):
        assert wheel.gain_mm == pytest.approx(abs(gain_mm), rel=0.01)
        assert wheel.dead_zone == dead_zone
        assert wheel.invert == is_inverted
    sent = np.abs(rig.actuator.sent_outputs)
    assert sent.max() <= LIMIT
    assert not rig.actuator.sent_outputs[-1].any()  # the robot stands at the end
