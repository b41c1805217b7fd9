"""Tests of the field's actuator: its commands, and its use with an emulated driver."""

import math
import random
from contextlib import suppress
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit.emulator.acting import act
from testkit.microscope.field_bench import LIMITS, Bench, Wire, section
from tetractl_emulator import firmware
from tetractl_emulator.pictures.driver_core import DriverLimits
from tetractl_microscope.coils.actuator import FieldActuator
from tetractl_microscope.coils.driver import Driver, decode_command

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.commands import Steer
from tetractl.core.errors import AbortError
from tetractl.core.poses import Pose
from tetractl.lab.cobs import Flag
from tetractl.lab.serial_port import PortHeldError

needs_compiler = pytest.mark.skipif(firmware.compiler() is None, reason="no C compiler found")
A = np.array([5.0, 3.5])
SPEED = np.array([300.0, 330.0])
SETUP = SimpleNamespace(a=A, speed=SPEED, strength=None, strength_unit="mT")
POSES = (Pose(0, 0, 0.2), Pose(1, 1, -2.0))
BOTH = (True, True)


def virtual(**changes):
    clock = VirtualClock()
    actuator = FieldActuator(section(**changes), SETUP, clock)
    actuator.driver = Wire(clock)
    return actuator, clock


def asked(actuator):
    """Return the newest currents on the wire [A]."""
    last = actuator.driver.sent[-1]
    return last.x_ma / 1000, last.y_ma / 1000


def gap(a, b):
    return math.remainder(a - b, math.tau)


@given(st.floats(-10, 10))
def test_the_field_turns_cells_by_the_papers_law(direction):
    actuator, _ = virtual(slew_max_a_s=10_000)
    sent = actuator.send(Steer(direction), POSES, BOTH, 0)
    headings = np.array([pose.heading for pose in POSES])
    assert sent.turning == pytest.approx(A * np.sin(direction - headings), abs=0.02)  # 1 mA
    assert (sent.speed == SPEED).all()
    assert sent.outputs["field_mt"] == pytest.approx(2.0, abs=0.005)
    assert gap(sent.outputs["field_direction_rad"], direction) == pytest.approx(0, abs=0.002)
    currents = sent.outputs["current_x_a"], sent.outputs["current_y_a"]
    assert currents == asked(actuator)
    assert math.hypot(*actuator.coils.field(currents)) == pytest.approx(sent.outputs["field_mt"])
    assert (sent.direction, sent.delivered, sent.left) == (direction, BOTH, None)


def test_no_cell_can_be_held_and_one_out_of_sight_has_no_known_turning():
    actuator, _ = virtual()
    sent = actuator.send(Steer(1.0), (None, POSES[1]), (False, True), 0)
    assert sent.delivered == (True, True)
    assert sent.turning[0] == 0 != sent.turning[1]


def test_where_the_current_limit_binds_cells_turn_more_slowly():
    actuator, _ = virtual(strength_mt=8.0, slew_max_a_s=10_000)
    direction = actuator.coils.rotation  # along the weaker pair
    sent = actuator.send(Steer(direction), POSES, BOTH, 0)
    assert asked(actuator)[0] == 2.0
    assert sent.outputs["field_mt"] == pytest.approx(4.03, abs=0.005)
    assert gap(sent.outputs["field_direction_rad"], direction) == pytest.approx(0, abs=0.002)
    expected = A * (4.03 / 8) * np.sin(direction - np.array([0.2, -2.0]))
    assert sent.turning == pytest.approx(expected, abs=0.02)


def test_the_slew_limit_is_kept_and_what_was_really_asked_is_told():
    actuator, clock = virtual(slew_max_a_s=10)
    before = (0.0, 0.0)
    reports = []
    for k in range(60):
        clock.sleep_until(k * actuator.period_ns)
        sent = actuator.send(Steer(0.0 if k < 20 else 3.0), POSES, BOTH, 0)
        now = asked(actuator)
        steps = [abs(n - b) for n, b in zip(now, before, strict=True)]
        assert max(steps) <= 10 * actuator.period_ns / SECOND + 0.001
        x, y = actuator.coils.field(now)
        assert sent.outputs["field_direction_rad"] == pytest.approx(math.atan2(y, x))
        # a times the field, relative to 2 mT, times the sine of its angle to the cell
        to_cells = math.atan2(y, x) - np.array([0.2, -2.0])
        turning = A * math.hypot(x, y) / 2 * np.sin(to_cells)
        assert sent.turning == pytest.approx(turning)
        reports.append(sent.outputs["field_direction_rad"])
        before = now
    assert gap(reports[19], 0.0) == pytest.approx(0, abs=0.002)
    assert abs(gap(reports[20], 3.0)) > 1  # on its way
    assert gap(reports[59], 3.0) == pytest.approx(0, abs=0.002)


def test_after_a_long_pause_or_a_stop_the_field_rises_from_where_the_driver_is():
    actuator, clock = virtual(slew_max_a_s=10)
    for k in range(10):
        clock.sleep_until(k * actuator.period_ns)
        actuator.send(Steer(0.3), POSES, BOTH, 0)
    full = asked(actuator)[0]
    clock.sleep_until(clock.now() + round(0.25 * SECOND))
    actuator.send(Steer(0.3), POSES, BOTH, 0)
    assert asked(actuator)[0] == full  # the watchdog has not begun
    clock.sleep_until(clock.now() + SECOND)
    actuator.send(Steer(0.3), POSES, BOTH, 0)
    assert asked(actuator)[0] == pytest.approx(0.25, abs=0.001)  # one period from nothing
    clock.sleep_until(clock.now() + actuator.period_ns)
    actuator.send(Steer(0.3), POSES, BOTH, 0)
    actuator.stop()
    clock.sleep_until(clock.now() + SECOND // 50)
    actuator.send(Steer(0.3), POSES, BOTH, 0)
    assert asked(actuator)[0] == pytest.approx(0.5 - 0.2 + 0.2, abs=0.001)


@pytest.mark.parametrize("emergency", [False, True])
def test_a_stop_is_sent_three_times_and_says_that_cells_swim_on(emergency):
    actuator, _ = virtual()
    actuator.send(Steer(1.0), POSES, BOTH, 0)
    stop = actuator.stop(emergency)
    flag = Flag.EMERGENCY_STOP if emergency else Flag(0)
    assert [(c.flags, c.x_ma, c.y_ma) for c in actuator.driver.sent[1:]] == [(flag, 0, 0)] * 3
    assert stop.direction is None
    assert (stop.speed == SPEED).all()
    assert (stop.turning == 0).all()
    assert (stop.outputs["current_x_a"], stop.outputs["current_y_a"]) == (0, 0)
    assert stop.outputs["field_mt"] == pytest.approx(0.05)  # the ambient field stays


# from here on: before an emulated driver


def fails(actuator):
    """Steer once more; return why that cannot be done any longer."""
    with suppress(AbortError):
        actuator.send(Steer(1.0), POSES, BOTH, 0)
    return actuator.failure


def stops(stage):
    """Return how many frames came without the run flag."""
    return sum(event == "command" and facts["flags"] == Flag.POLL for event, facts in stage.told)


@needs_compiler
def test_leaving_switches_the_field_off_before_the_watchdog_would():
    stage = Bench(DriverLimits(2000, 100_000, watchdog_ms=5000))
    with stage.opened(SETUP, watchdog=5.0) as actuator:
        actuator.send(Steer(1.0), POSES, BOTH, 0)
        assert stage.clock.wait(lambda: max(map(abs, stage.driver.currents)) > 0.5)
    actuator.__exit__(None, None, None)
    assert stage.clock.wait(lambda: max(map(abs, stage.driver.currents)) < 1e-6)


@needs_compiler
@pytest.mark.parametrize(
    ("limits", "changes", "says"),
    [
        (
            DriverLimits(1500, 100_000),
            {},
            "allows only 1.5 A, but the spec allows 2 A: lower current_max_a in the spec",
        ),
        (
            DriverLimits(2000, 50_000),
            {},
            "allows only 50 A/s, but the spec allows 100 A/s: lower slew_max_a_s in the spec",
        ),
        (DriverLimits(2000, 100_000, 500), {}, "watchdog is 0.5 s, but the spec's is 0.25 s"),
        (LIMITS, {"supply_min_v": 20.0}, "supply voltage of the current driver is 12.00 V"),
    ],
)
def test_a_driver_that_would_not_do_is_a_problem(limits, changes, says):
    with Bench(limits).opened(SETUP, **changes) as actuator:
        (problem,) = actuator.check().problems
    assert says in problem


@needs_compiler
def test_weak_coils_and_a_strong_driver_are_warned_of():
    with Bench(DriverLimits(3000, 100_000)).opened(SETUP, strength_mt=5.0) as actuator:
        health = actuator.check()
    assert health.problems == ()
    weak, strong = health.warnings
    assert "a field of 5 mT, but in some directions the coils reach only 3.97 mT" in weak
    assert "the current driver itself allows 3 A" in strong


@needs_compiler
def test_an_emergency_stop_latches_until_the_driver_is_switched_off():
    stage = Bench()
    with stage.opened(SETUP) as actuator:
        actuator.stop(emergency=True)
        assert stage.clock.wait(
            lambda: actuator.failure == "the current driver is emergency-stopped"
        )
        with pytest.raises(AbortError, match="emergency-stopped"):
            actuator.send(Steer(1.0), POSES, BOTH, 0)
        (problem,) = actuator.check().problems
        assert "switch it off and on again" in problem
    stage.clock.sleep_until(stage.clock.now() + SECOND // 10)  # until the last stop is heard
    stage.driver.switch(False)
    stage.driver.switch(True)
    with stage.opened(SETUP) as actuator:
        assert actuator.check().problems == ()
        actuator.send(Steer(1.0), POSES, BOTH, 0)


@needs_compiler
def test_heat_ends_a_run():
    stage = Bench()
    with stage.opened(SETUP) as actuator:
        act(stage.driver.acting, "hot", celsius=85)

        assert stage.clock.wait(lambda: fails(actuator))
        assert actuator.failure == "the current driver has stopped because it is 85 °C hot"
        assert len(actuator.check().problems) == 3  # hot before, latched, hot now


@needs_compiler
@pytest.mark.parametrize(("celsius", "problems"), [(59.9, 0), (60, 1)])
def test_a_run_does_not_start_with_hot_coils(celsius, problems):
    stage = Bench()
    act(stage.driver.acting, "hot", celsius=celsius)
    with stage.opened(SETUP) as actuator:
        stage.clock.sleep_until(stage.clock.now() + SECOND // 100)  # it has measured
        health = actuator.check().problems
    assert health == ("the coils are at 60 °C: let them cool down",) * problems


@needs_compiler
def test_a_driver_that_falls_silent_is_noticed():
    stage = Bench()
    with stage.opened(SETUP) as actuator:
        assert actuator.check().problems == ()
        act(stage.driver.acting, "mute")

        assert stage.clock.wait(lambda: fails(actuator))
        assert actuator.failure == "the current driver does not answer any more"
        with pytest.raises(AbortError, match="does not answer") as got:
            actuator.send(Steer(1.0), POSES, BOTH, 0)
        assert "cells swim on" in got.value.hint
        before = stops(stage)
        actuator.stop()  # it may hear all the same
        assert stage.clock.wait(lambda: stops(stage) == before + 3)


@pytest.fixture
def stop_coils(monkeypatch):
    """Return what `lab stop` does at the port of an emulated driver: what it says, or its error."""

    def stop(stage, alone=True):
        monkeypatch.setattr("tetractl_microscope.coils.driver.SerialPort", stage.network.serial)
        return section(port="coils").stop_all(SETUP, stage.clock, alone)

    return stop


def assert_is_latched(stage):
    """The driver says that it has latched an emergency stop."""
    with stage.opened(SETUP) as actuator:
        (problem,) = actuator.check().problems
    assert "emergency-stopped" in problem


@needs_compiler
def test_lab_stop_latches_the_driver(stop_coils):
    stage = Bench()
    assert stop_coils(stage) == "sent 10 stops"
    assert_is_latched(stage)


@needs_compiler
@pytest.mark.parametrize(("baud", "mute"), [(115_200, True), (9600, False)])
def test_lab_stop_says_that_no_driver_replies_that_it_is_stopped(stop_coils, baud, mute):
    """Regression: it said `sent 10 stops`, as if the field were off, though no reply came: the
    driver had no power or another speed, or was at another port."""
    stage = Bench(baud=baud)
    if mute:
        act(stage.driver.acting, "mute")
    with pytest.raises(AbortError, match="sent 10 stops, but no current driver on") as raised:
        stop_coils(stage)
    assert raised.value.hint == "switch off the power supply of the current driver"


@needs_compiler
def test_lab_stop_is_sent_next_to_a_run_that_has_the_port(stop_coils):
    """Regression: the field stayed on until the run had ended, and next to a program that cannot be
    ended it was not switched off at all."""
    stage = Bench()
    with stage.opened(SETUP) as run:
        run.send(Steer(1.0), POSES, BOTH, 0)
        with pytest.raises(PortHeldError):
            stop_coils(stage)
        assert stop_coils(stage, alone=False) == "sent 10 stops"
    assert_is_latched(stage)


def test_the_spec_may_state_the_strength_instead():
    clock = VirtualClock()
    setup = SimpleNamespace(**vars(SETUP) | {"strength": 1.5})
    alone = section(strength_mt=None, slew_max_a_s=10_000)
    actuator = FieldActuator(alone, setup, clock)
    actuator.driver = Wire(clock)
    sent = actuator.send(Steer(0.4), POSES, BOTH, 0)
    assert sent.outputs["field_mt"] == pytest.approx(1.5, abs=0.005)
    assert sent.turning == pytest.approx(A * np.sin(0.4 - np.array([0.2, -2.0])), abs=0.02)
    assert list(alone.contradictions(setup)) == []
    ((_, twice),) = section(strength_mt=2.0).contradictions(setup)
    ((_, unknown),) = alone.contradictions(SETUP)
    setup.strength_unit = "V/cm"
    ((_, electric),) = alone.contradictions(setup)
    assert "already" in twice
    assert "needs the field's strength" in unknown
    assert "strength is in V/cm" in electric


def test_commands_in_quick_succession_do_not_beat_the_slew_limit():
    actuator, clock = virtual(slew_max_a_s=10)
    for k in range(40):
        clock.sleep_until(k * SECOND // 1000)  # 1 kHz
        actuator.send(Steer(0.0), POSES, BOTH, 0)
    assert max(map(abs, asked(actuator))) <= 10 * (0.025 + 0.039) + 0.001


def test_once_one_stop_was_an_emergency_stop_every_command_is():
    heard = []

    def port(*_):
        return SimpleNamespace(write=lambda data: heard.append(data) or 0)

    driver = Driver("/dev/null", 115200, VirtualClock(), port)
    for flag in (Flag.RUN, Flag.EMERGENCY_STOP, Flag(0), Flag.POLL):
        driver.send(flag)
    flags = [decode_command(frame[:-1]).flags for frame in heard]
    assert [Flag.EMERGENCY_STOP in flag for flag in flags] == [False, True, True, True]


@needs_compiler
def test_another_speed_or_no_driver_is_told():
    stage = Bench(baud=9600)
    with stage.opened(SETUP) as actuator:
        (problem,) = actuator.check().problems
    assert "no current driver answers on" in problem
    assert "at 115200 baud" in problem
    assert stage.driver.n_garbled_chunks > 0


@needs_compiler
def test_garbage_on_the_line_is_dropped():
    stage = Bench()
    with stage.opened(SETUP) as actuator:
        stage.port.write(random.Random(1).randbytes(2000) + b"\0" + b"\x05noise\0")
        assert actuator.check().problems == ()
