"""Tests of an emulated cube: its program, and the events of its connection."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit.emulator.acting import act
from tetractl_emulator.faults import ActingFaults
from tetractl_emulator.loop import Timeline
from tetractl_toio.emulated.cube import (
    BATTERY_EMPTY_MV,
    BATTERY_FULL_MV,
    RUN_FLAG,
    STOP_FLAG,
    Connection,
    CubeProgram,
    to_whole_ms_ns,
)
from tetractl_toio.messages import (
    NOTIFY_MISSED,
    NOTIFY_READINGS,
    SPEED_MAX,
    SPEED_MIN,
    Characteristic,
    Unpacker,
    encode_motor,
    pack,
)

from tetractl.core.clock import MILLISECOND, SECOND
from tetractl.lab.actuators.wheel_commands import Status

INTERVAL_NS = 30 * MILLISECOND
PHASE_NS = 7 * MILLISECOND


def motor(left, right, duration_ms=100):
    return pack(Characteristic.MOTOR, encode_motor(left, right, duration_ms))


def answers(program, now_ms=0):
    return list(Unpacker().feed(program.take_reply(now_ms)))


@pytest.mark.parametrize(("after_ms", "drives"), [(0, True), (99, True), (100, False)])
def test_a_cube_drives_for_the_duration_of_its_command(after_ms, drives):
    program = CubeProgram()
    program.push(motor(50, -60), 1000)
    now_ms = 1000 + after_ms
    assert program.status(now_ms) == (Status.RUNNING if drives else Status.SILENT)
    assert program.wheels(now_ms) == ((50, -60) if drives else (0, 0))


def test_a_command_without_a_duration_lasts_and_one_that_stops_is_not_silent():
    program = CubeProgram()
    assert program.status(0) == Status.SILENT
    program.push(pack(Characteristic.MOTOR, b"\x01" + encode_motor(50, 60, 10)[1:7]), 0)
    assert program.wheels(10**6) == (50, 60)
    program.push(motor(0, 0), 10**6)
    assert program.status(10**6 + 50) == Status(0)
    assert program.status(10**6 + 100) == Status.SILENT


def test_a_new_command_replaces_the_speeds_and_the_duration_of_the_last():
    program = CubeProgram()
    program.push(motor(50, 50, 100), 0)
    program.push(motor(20, 30, 100), 60)
    assert program.wheels(159) == (20, 30)
    assert program.wheels(160) == (0, 0)


@given(left=st.integers(-SPEED_MAX, SPEED_MAX), right=st.integers(-SPEED_MAX, SPEED_MAX))
def test_a_wheel_turns_from_the_minimum_speed_on(left, right):
    program = CubeProgram()
    program.push(motor(left, right), 0)
    expected = tuple(0 if -SPEED_MIN < speed < SPEED_MIN else speed for speed in (left, right))
    assert program.wheels(0) == expected


def test_a_command_that_is_invalid_changes_nothing():
    program = CubeProgram()
    program.push(motor(50, 60), 0)
    program.push(pack(Characteristic.MOTOR, b"\x02\x03"), 50)
    assert program.wheels(99) == (50, 60)
    assert program.wheels(100) == (0, 0)


@pytest.mark.parametrize(
    ("battery_mv", "charge"),
    [
        (BATTERY_FULL_MV, 100),
        (BATTERY_FULL_MV + 500, 100),
        (BATTERY_EMPTY_MV, 0),
        (BATTERY_EMPTY_MV - 500, 0),
        ((BATTERY_EMPTY_MV + BATTERY_FULL_MV) // 2, 50),
        (BATTERY_EMPTY_MV + 60, 10),  # in steps of 10 %
    ],
)
def test_the_charge_follows_the_voltage_and_is_answered_when_asked(battery_mv, charge):
    program = CubeProgram()
    program.set_battery(battery_mv)
    program.push(pack(Characteristic.BATTERY), 0)
    assert answers(program) == [(Characteristic.BATTERY, bytes([charge]))]
    assert answers(program) == []


def test_a_cube_that_is_set_to_notify_says_so_and_that_it_is_emulated():
    program = CubeProgram()
    assert not program.is_notifying
    for setting, echo in ((NOTIFY_READINGS, 0x98), (NOTIFY_MISSED, 0x99)):
        program.push(pack(Characteristic.CONFIGURATION, setting), 0)
        (first, name), (second, answer) = answers(program)
        assert (first, second) == (Characteristic.EMULATED, Characteristic.CONFIGURATION)
        assert name
        assert answer == bytes([echo, 0, 0])
    assert program.is_notifying


@pytest.mark.parametrize("payload", [b"", b"\x05\x00\x01"])
def test_other_settings_are_ignored(payload):
    program = CubeProgram()
    program.push(pack(Characteristic.CONFIGURATION, payload), 0)
    assert not program.is_notifying
    assert answers(program) == []


def test_only_a_message_without_data_asks():
    program = CubeProgram()
    program.push(pack(Characteristic.ID, b"\x01") + pack(Characteristic.BATTERY, b"\x01"), 0)
    assert not program.is_reading_requested
    assert answers(program) == []
    program.push(pack(Characteristic.ID), 0)
    assert program.is_reading_requested


class Cube:
    """Stands for an emulated cube."""

    def __init__(self, name):
        self.name = name
        self.powered = True
        self.late_ns = 0
        self.heard = []
        self.answers = []

    def receive(self, data):
        self.heard.append((data, self.timeline.now_ns))

    def answer(self):
        return self.answers.pop(0) if self.answers else b""


class Link:
    """The connection to the second of two cubes, in virtual time, and what its port is sent."""

    def __init__(self, loss=0.0, seed=1):
        self.timeline = Timeline(lambda when_ns: None, SECOND)
        self.acting = ActingFaults()
        self.events = []
        stage = SimpleNamespace(
            timeline=self.timeline,
            note=lambda event, **facts: self.events.append((event, facts)),
            acting=self.acting,
        )
        self.written = []
        self.port = SimpleNamespace(
            fd=3,
            name="udp://127.0.0.1:9801",
            baud=lambda: None,
            write=lambda data: self.written.append((data, self.timeline.now_ns)),
        )
        cubes = [Cube("green"), Cube("blue")]
        for cube in cubes:
            cube.timeline = self.timeline
        self.cube = cubes[1]
        self.connection = Connection(
            stage, self.port, self.cube, cubes, INTERVAL_NS, PHASE_NS, loss, seed
        )

    def run(self, ms):
        self.timeline.run_to(SECOND + ms * MILLISECOND)

    def heard(self):
        return [(data, (at_ns - SECOND) // MILLISECOND) for data, at_ns in self.cube.heard]

    def sent(self):
        return [(data, (at_ns - SECOND) // MILLISECOND) for data, at_ns in self.written]


def test_what_is_written_is_heard_at_the_next_event_in_its_order():
    link = Link()
    link.connection.receive(b"a")
    link.connection.receive(b"b")
    link.run(6)
    assert link.heard() == []
    link.run(20)
    link.connection.receive(b"c")
    link.run(200)
    assert link.heard() == [(b"a", 7), (b"b", 7), (b"c", 37)]


def test_readings_and_answers_are_sent_at_the_next_event():
    link = Link()
    reported = []
    link.run(8)
    link.connection.notify(b"1", lambda: reported.append(1))
    link.connection.notify(b"2", lambda: reported.append(2))
    link.cube.answers = [b"!"]
    link.run(200)
    assert link.sent() == [(b"12!", 37)]
    assert reported == [2]


def test_an_answer_is_sent_without_a_reading():
    link = Link()
    link.cube.answers = [b"!"]
    link.run(100)
    assert link.sent() == [(b"!", 7)]


@pytest.mark.parametrize("why", ["unplugged", "restarting", "off"])
def test_nothing_is_sent_by_a_cube_that_is_gone_and_its_readings_are_lost(why):
    link = Link()
    reported = []
    if why == "unplugged":
        link.port.fd = -1
    elif why == "restarting":
        fault = act(link.acting, "radio_resets")
    else:
        link.cube.powered = False
    link.connection.notify(b"1", lambda: reported.append(1))
    link.run(10)
    link.port.fd = 0
    link.cube.powered = True
    if why == "restarting":
        link.acting.remove(fault)
    link.run(100)
    assert link.sent() == []
    assert reported == []
    link.connection.notify(b"2", lambda: reported.append(2))
    link.run(200)
    assert reported == [2]


def test_a_late_connection_keeps_the_order_of_what_it_passes_on():
    link = Link()
    fault = act(link.acting, "late_radio", by=0.1)
    link.cube.late_ns = 5 * MILLISECOND
    link.connection.receive(b"a")
    link.run(10)
    link.acting.remove(fault)
    link.connection.receive(b"b")
    link.run(300)
    assert link.heard() == [(b"a", 112), (b"b", 112)]


def test_transfers_are_lost_in_both_directions_as_often_as_the_loss_says():
    link = Link(loss=0.25, seed=62)
    reported = []
    for k in range(1, 2001):
        link.connection.receive(b"a")
        link.connection.notify(b"1", lambda: reported.append(1))
        link.run(30 * k)
    counts = [len(link.cube.heard), len(reported)]
    assert counts == pytest.approx([1500, 1500], abs=4 * np.sqrt(2000 * 0.25 * 0.75))


def test_a_doubled_transfer_is_heard_twice_and_a_deaf_cube_hears_nothing():
    link = Link()
    doubled = act(link.acting, "doubled_packets")
    link.connection.receive(b"a")
    link.run(100)
    assert link.heard() == [(b"a", 7)] * 2
    link.acting.remove(doubled)
    act(link.acting, "deaf", robot="green", share=1.0)
    link.connection.receive(b"b")
    link.run(200)
    assert len(link.cube.heard) == 3
    act(link.acting, "deaf", robot="blue", share=1.0)
    link.connection.receive(b"c")
    link.run(300)
    assert len(link.cube.heard) == 3


def test_motor_commands_are_recorded_with_the_cube_that_they_drive():
    link = Link()
    link.connection._record_commands(motor(50, 0) + pack(Characteristic.ID) + motor(0, 0))
    assert link.events == [
        ("command", {"flags": RUN_FLAG, "motors": [50, 0], "drives": [False, True]}),
        ("command", {"flags": STOP_FLAG, "motors": [0, 0], "drives": [False, False]}),
    ]


def test_times_are_rounded_to_whole_milliseconds():
    assert to_whole_ms_ns(0.0304) == 30 * MILLISECOND
    assert to_whole_ms_ns(0.0306) == 31 * MILLISECOND
    assert to_whole_ms_ns(2.0) == 2 * SECOND
