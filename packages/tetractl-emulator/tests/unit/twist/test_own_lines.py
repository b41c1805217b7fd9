"""Tests of the program of an emulated robot that takes messages of its own."""

import pytest
from tetractl_emulator.twist.own_lines import OwnProgram

from tetractl.lab.actuators.wheel_commands import Status

WATCHDOG_MS = 250


def program():
    def read(message):
        left, right = message.split()
        return int(left), int(right)

    return OwnProgram(read, WATCHDOG_MS / 1000)


@pytest.mark.parametrize(("after_ms", "drives"), [(0, True), (249, True), (250, False)])
def test_a_robot_drives_at_its_newest_speeds_until_its_watchdog_expires(after_ms, drives):
    robot = program()
    robot.push(b"10 20", 5000)
    robot.push(b"-30 40", 6000)
    now_ms = 6000 + after_ms
    assert robot.wheels(now_ms) == ((-30, 40) if drives else (0, 0))
    assert robot.status(now_ms) == (Status.RUNNING if drives else Status.SILENT)


def test_a_robot_that_was_told_to_stop_is_neither_running_nor_silent():
    robot = program()
    robot.push(b"0 0", 6000)
    assert robot.wheels(6000) == (0, 0)
    assert robot.status(6000) == Status(0)
    robot.push(b"0 -1", 6010)
    assert robot.status(6010) == Status.RUNNING


@pytest.mark.parametrize("message", [b"", b"10", b"10 20 30", b"ten 20", b"\xff\xfe 1"])
def test_a_message_that_cannot_be_read_changes_nothing_and_feeds_no_watchdog(message):
    robot = program()
    robot.push(b"10 20", 6000)
    robot.push(message, 6200)
    assert robot.wheels(6249) == (10, 20)
    assert robot.wheels(6250) == (0, 0)


def test_a_robot_has_nothing_to_answer():
    robot = program()
    robot.push(b"10 20", 6000)
    assert robot.take_reply(6000) == b""
    robot.set_battery(3000)
    assert robot.wheels(6001) == (10, 20)
