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
from tetractl.core.poses import CameraFrame, Pose
from tetractl.core.protocols import LabSupervision
from tetractl.lab.actuators.wheel_commands import WheeledActuator
from tetractl.lab.calibrate import (
    Channel,
    SteadyMotion,
    _CalibrationBench,
    _excess_delay_s,
    _fit_steady_motion,
    calibrate_robots,
)
from tetractl.lab.frames import AcceptedFrame, TimedPose
from tetractl.lab.rig import Rig
from tetractl.spec.load import parse_spec
from tetractl.spec.plants import select_plant


class SteeringActuator:
    """An actuator of which nothing says that its robots have wheels; it is never opened."""


def test_an_actuator_without_wheels_is_not_calibrated():
    """Regression: an assertion failed; under `python -O` the robots were driven at the spec's
    speed, whatever the limit."""
    experiment = select_plant(parse_spec(SPEC, "lab.yaml"), "lab").experiment
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
        outputs = np.zeros(2) if isinstance(action, Stop) else self.held_outputs[:, 0] * 1.0
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
    lab = select_plant(spec, "lab").experiment.plant
    setup = select_plant(spec, "lab").experiment.setup
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


def bench(rates=(), limit=127, scale=1.0, dead_zone_max=60):
    """A bench whose motor channel turns its robot at the rate of a function of the output."""
    made = object.__new__(_CalibrationBench)
    made.name = "green"
    made.limit = limit
    made._scale = scale
    made._dead_zone_max = dead_zone_max
    made.driven = []
    made._stop_and_wait = lambda: made.driven.append("stand")

    def rate(number, output):
        made.driven.append(output)
        return rates(output)

    made._measure_rate = rate
    return made


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("dead_zone", [0, 7, 30])
@pytest.mark.parametrize(("scale", "limit"), [(1.0, 45), (3.0, 135), (1.0, 127)])
def test_a_channel_is_a_line_beyond_its_dead_zone(sign, dead_zone, scale, limit):
    def rates(output):
        return sign * 0.19 / scale * max(0, output - dead_zone * scale)

    made = bench(rates, limit, scale, dead_zone_max=200)
    channel = made._fit_channel(0)
    assert (channel.sign, channel.dead_zone) == (sign, round(dead_zone * scale))
    assert channel.k == pytest.approx(0.19 / scale)
    assert made.driven.pop() == "stand"
    assert made.driven[0] == round(6 * scale)
    assert max(made.driven) <= limit < max(made.driven) + 4 * scale
    assert channel.output(1.9) == round(10 * scale) + channel.dead_zone


def test_a_dead_zone_is_at_most_what_the_section_can_state():
    channel = bench(lambda output: 0.2 * max(0, output - 20), dead_zone_max=5)._fit_channel(0)
    assert channel.dead_zone == 5


def test_slow_turns_do_not_count_as_they_may_be_a_wheel_that_sticks():
    """Below 0.25 rad/s the rate is wrong here, but the line through the others is right."""
    channel = bench(lambda output: 0.05 * output if output > 5 else 9.0)._fit_channel(0)
    assert channel.k == pytest.approx(0.05)
    wrong_when_slow = bench(lambda o: 0.02 * o if 0.02 * o > 0.25 else 0.24)._fit_channel(0)
    assert wrong_when_slow.k == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("rates", "says"),
    [
        (lambda output: 0.0, "motor channel 2 hardly turns the robot"),
        (lambda output: 0.2 * (output > 100) * output, None),
        (lambda output: 0.2 * (output > 118) * output, "hardly turns"),
        (lambda output: 20.0 - 0.1 * output, "does not turn the robot steadily"),
        (lambda output: 0.1 * output * (-1) ** (output > 50), "does not turn the robot steadily"),
    ],
)
def test_a_channel_that_does_not_turn_the_robot_is_refused(rates, says):
    if says is None:
        bench(rates)._fit_channel(1)
        return
    with pytest.raises(AbortError, match=says):
        bench(rates)._fit_channel(1)


@pytest.mark.parametrize(
    ("radius_mm", "refused"), [(4.9, True), (5.1, False), (499.0, False), (501.0, True)]
)
def test_a_radius_is_the_speed_over_the_turning_rates_of_both_wheels(radius_mm, refused):
    channels = [Channel(1, 0.1, 3), Channel(-1, 0.2, 5)]
    turning = 0.1 * (13 - 3) + 0.2 * (15 - 5)
    straight = SteadyMotion(0.0, -0.6 * radius_mm * turning, 0.8 * radius_mm * turning)
    if refused:
        with pytest.raises(AbortError, match="is impossible"):
            bench()._compute_radius(straight, channels, [13, 15])
    else:
        assert bench()._compute_radius(straight, channels, [13, 15]) == pytest.approx(radius_mm)


@pytest.mark.parametrize(
    ("degrees", "refused"), [(0, False), (59, False), (-59, False), (61, True), (-61, True)]
)
def test_an_offset_is_the_direction_of_travel_without_a_drift(degrees, refused):
    angle = math.radians(degrees)
    along, across = 50 * math.cos(angle), 50 * math.sin(angle)
    forwards = SteadyMotion(0.0, along + 7, across - 9)
    backwards = SteadyMotion(0.0, -along + 7, -across - 9)
    if refused:
        with pytest.raises(AbortError, match=f"{degrees} degrees off"):
            bench()._compute_offset(forwards, backwards)
    else:
        assert bench()._compute_offset(forwards, backwards) == pytest.approx(angle)


@pytest.mark.parametrize("mm", [1.0, 1000.0])
@pytest.mark.parametrize(
    ("turning", "speed", "course"), [(1.5, 80, 0.0), (-4.0, 60, 0.5), (0.0, 9, -1.0)]
)
def test_a_steady_motion_has_its_turning_rate_and_its_speeds_in_mm(mm, turning, speed, course):
    poses, x, y = [], 0.3, -0.2
    for k in range(121):
        heading = 3.0 + turning * k / 120
        wrapped = math.remainder(heading, math.tau)
        poses.append(TimedPose(k * SECOND // 120, Pose(x / mm, y / mm, wrapped)))
        middle = heading + turning / 240 + course
        x += speed / 120 * math.cos(middle)
        y += speed / 120 * math.sin(middle)
    before = [TimedPose(0, Pose(99.0, 99.0, 1.0))]  # the wheels have not settled yet
    shifted = [TimedPose(timed.exposed_ns + SECOND, timed.pose) for timed in poses]
    path = _fit_steady_motion(before + shifted, SECOND, mm)
    assert path.turning == pytest.approx(turning, abs=1e-6)
    expected = (speed * math.cos(course), speed * math.sin(course))
    assert (path.along, path.across) == pytest.approx(expected, abs=1e-6)


def frames_of(period_ms, way_ms, count=9):
    made = []
    for k in range(count):
        at_ns = k * period_ms * SECOND // 1000
        frame = CameraFrame(k, at_ns, at_ns + way_ms * SECOND // 1000, (None,))
        made.append(AcceptedFrame(frame, (None,), (False,)))
    return made


@pytest.mark.parametrize(
    ("period_ms", "way_ms", "excess_s"),
    [(8, 5, 0.0), (20, 10, 0.0), (20, 20, 0.01), (50, 10, 0.075), (100, 30, 0.22)],
)
def test_a_slow_camera_may_be_later_by_two_and_a_half_periods_and_its_latency(
    period_ms, way_ms, excess_s
):
    assert _excess_delay_s(frames_of(period_ms, way_ms)) == pytest.approx(excess_s)
    assert _excess_delay_s(frames_of(period_ms, way_ms, 3)) == pytest.approx(excess_s)
    assert _excess_delay_s(frames_of(period_ms, way_ms, 2)) == 0
