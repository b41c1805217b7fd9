"""Tests of emulated robots on two wheels: their wheels, pushes, and commands from elsewhere."""

import math
from random import Random
from types import SimpleNamespace

import pytest
from testkit.emulator.device_specs import TWIST_SPEC
from testkit.emulator.virtual_lab import virtual_lab
from testkit.lab_specs import SPEC
from tetractl_emulator.loop import Timeline
from tetractl_emulator.m3pi.wheeled_side import (
    WHEELED_FAULTS,
    PortedSide,
    WheeledSide,
    robots_of_day,
)

from tetractl.core.clock import SECOND
from tetractl.spec.lab_section import STOP_COUNT, STOP_GAP_NS
from tetractl.spec.load import parse_spec


class Radio:
    """Notes what it receives from another sender, with its time."""

    def __init__(self, timeline):
        self.timeline = timeline
        self.sequence = 250
        self.driven = []
        self.stopped = []

    def drive_from_other_program(self, sequence, counts):
        self.driven.append((self.timeline.now_ns, sequence, counts))

    def stop_from_other_program(self, number):
        self.stopped.append((self.timeline.now_ns, number))


class Side(WheeledSide):
    """A side that consists of two radios."""

    def __init__(self):
        self.timeline = Timeline(lambda now_ns: None)
        self._radios = [Radio(self.timeline) for _ in range(2)]

    radios = property(lambda self: self._radios)


def test_another_sender_sends_ten_stops_at_the_usual_times():
    side = Side()
    side.stop_from_other_program()
    side.timeline.run_to(3 * SECOND)
    for radio in side.radios:
        assert radio.stopped == [(k * STOP_GAP_NS, k) for k in range(STOP_COUNT)]


@pytest.mark.parametrize("follows", [False, True])
def test_another_sender_drives_at_its_rate_until_the_fault_ends(follows):
    side = Side()
    fault = SimpleNamespace(rate=10.0, follows=follows, counts=(20, -20))
    end = side.drive_from_other_program(fault)
    side.timeline.run_to(SECOND)
    end()
    side.timeline.run_to(2 * SECOND)
    for radio in side.radios:
        assert [at_ns for at_ns, _, _ in radio.driven] == [k * SECOND // 10 for k in range(11)]
        numbers = [sequence for _, sequence, _ in radio.driven]
        assert numbers == ([251] * 11 if follows else list(range(11)))
        assert {counts for _, _, counts in radio.driven} == {(20, -20)}


LINES = TWIST_SPEC.replace("name: green, right_gain: 1.05", "name: green, left_gain: 0.9")


def lab_of_lines(script="", spec=LINES):
    return virtual_lab(None, spec=spec, script=script)


def speeds(lab, counts=(20, 20), seconds=0.2):
    """The wheel speeds of both robots [mm/s], which are sent counts by another program."""
    actuator = lab.emulation.actuator
    for radio in actuator.radios:
        radio.drive_from_other_program(1, counts)
    lab.clock.sleep_until(lab.clock.now() + round(seconds * SECOND))
    return [robot.wheels for robot in actuator.robots]


@pytest.mark.slow
def test_wheels_turn_at_the_gains_of_the_spec_unless_the_script_has_others():
    with lab_of_lines() as lab:
        (left, right), (blue_left, blue_right) = speeds(lab)
        assert left / right == pytest.approx(0.9, abs=0.002)
        assert blue_left == pytest.approx(blue_right)
        assert right == pytest.approx(160.0, rel=0.01)  # 20 counts of 8 mm/s
    true = "emulation: {actuator: {robots: [{name: blue, left_gain: 1.1, right_gain: 0.8}]}}"
    with lab_of_lines(true) as lab:
        (left, right), (blue_left, blue_right) = speeds(lab)
        assert left / right == pytest.approx(0.9, abs=0.002)
        assert (blue_left, blue_right) == pytest.approx((176.0, 128.0), rel=0.01)


@pytest.mark.slow
def test_each_robot_follows_with_its_own_lag():
    true = "emulation: {actuator: {robots: [{name: blue, lag: 0.4}]}}"
    with lab_of_lines(true) as lab:
        (_, right), (_, blue_right) = speeds(lab, seconds=0.042)  # 0.04 s after it arrived
    assert right == pytest.approx(160 * (1 - math.exp(-1)), rel=0.1)
    assert blue_right == pytest.approx(160 * (1 - math.exp(-0.1)), rel=0.1)


@pytest.mark.slow
def test_robots_are_driven_while_any_motor_turns():
    with lab_of_lines() as lab:
        actuator = lab.emulation.actuator
        assert not actuator.driven
        speeds(lab, (0, 5), 0.05)
        assert actuator.driven
        assert actuator.truth["status"] == [1, 1]
        assert [left for left, _ in actuator.truth["wheels"]] == [0.0, 0.0]
        lab.clock.sleep_until(lab.clock.now() + SECOND)
        assert not actuator.driven
        assert actuator.robot("blue") is actuator.robots[1]


@pytest.mark.slow
@pytest.mark.parametrize("at_once", [False, True])
def test_a_push_moves_and_turns_one_robot_by_what_it_says_in_a_fifth_of_a_second(at_once):
    with lab_of_lines() as lab:
        actuator = lab.emulation.actuator
        green, blue = actuator.robots
        before = (blue.x, blue.y, blue.heading)
        still = (green.x, green.y, green.heading)
        push = SimpleNamespace(robot="blue", by=(80.0, -40.0), turn=0.4, at_once=at_once)
        actuator.push(push)
        lab.clock.sleep_until(lab.clock.now() + SECOND // 10)
        part = 1.0 if at_once else 0.5
        assert blue.x - before[0] == pytest.approx(80 * part, abs=4)
        lab.clock.sleep_until(lab.clock.now() + SECOND)
        after = (blue.x, blue.y, blue.heading)
        off = [new - old for new, old in zip(after, before, strict=True)]
        assert off == pytest.approx([80.0, -40.0, 0.4])
        assert (green.x, green.y, green.heading) == still


@pytest.mark.slow
def test_robots_with_swapped_numbers_obey_the_commands_for_each_other_until_it_ends():
    with virtual_lab(None, spec=SPEC) as lab:
        green, blue = lab.emulation.actuator.robots
        fault = SimpleNamespace(robot="green", other="blue")
        kinds = {kind.__name__: kind for kind in WHEELED_FAULTS}
        undo = kinds["swapped_numbers"].begin(fault, lab.emulation.actuator)
        assert (green.index, blue.index) == (1, 0)
        undo()
        assert (green.index, blue.index) == (0, 1)


def test_a_day_has_wheels_and_batteries_of_its_own_within_their_limits():
    names = [f"robot {k}" for k in range(400)]
    day = robots_of_day(Random(52), names, "{}_gain", lambda fraction: fraction)
    assert 0 <= day["loss"] <= 0.05
    assert [robot["name"] for robot in day["robots"]] == names
    for key, low, high in (
        ("left_gain", 0.95, 1.05),
        ("right_gain", 0.95, 1.05),
        ("lag", 0.02, 0.08),
        ("battery_mv", 4600, 5300),
    ):
        values = [robot[key] for robot in day["robots"]]
        assert low <= min(values) < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < max(values) <= high
    assert robots_of_day(Random(52), names, "{}_gain", lambda fraction: fraction) == day


def test_the_gains_of_a_day_are_around_those_of_the_spec():
    experiment = parse_spec(TWIST_SPEC, "lab.yaml").experiment
    gains = {"left_gain": [], "right_gain": []}
    for day in range(200):
        made = PortedSide.world_of_day(Random(day), experiment.lab, experiment.setup)
        green, blue = made["robots"]
        for side, values in gains.items():
            values.append((green[side], blue[side]))
    for (side, values), spec_gain in zip(gains.items(), (1.0, 1.05), strict=True):
        green, blue = zip(*values, strict=True)
        assert sum(green) / 200 == pytest.approx(spec_gain, abs=0.01)
        assert sum(blue) / 200 == pytest.approx(1.0, abs=0.01)
        assert max(green) <= 1.05 * spec_gain + 1e-9, side
