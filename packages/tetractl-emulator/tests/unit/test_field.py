"""Tests of the emulated current driver, with the real firmware's core, and of a dish's faults."""

import math
from types import SimpleNamespace

import pytest
from testkit.emulator.acting import act
from testkit.emulator.virtual_lab import virtual_dish
from tetractl_emulator import firmware
from tetractl_emulator.faults import ActingFaults
from tetractl_emulator.loop import Timeline
from tetractl_emulator.pictures.driver_core import DriverLimits
from tetractl_emulator.pictures.field import FAULTS, CurrentDriver
from tetractl_microscope.coils.driver import (
    DriverStatus,
    FieldCommand,
    decode_reply,
    encode_command,
)

from tetractl.core.clock import MILLISECOND
from tetractl.core.errors import UsageError
from tetractl.lab.cobs import Flag, FrameSplitter

pytestmark = pytest.mark.skipif(firmware.compiler() is None, reason="no C compiler found")
LAG_S = 0.004
LIMITS = DriverLimits(current_max_ma=2000, slew_ma_s=1_000_000)
KINDS = {kind.__name__: kind for kind in FAULTS}


class Driver:
    """A driver in virtual time at a port where a test is the program."""

    def __init__(self, limits=LIMITS):
        self.acting = ActingFaults()
        self.timeline = Timeline(lambda until_ns: self.driver.advance(until_ns))
        self.events = []
        self.written = []
        self.waiting = []
        port = SimpleNamespace(
            name="coils",
            baud=lambda: 115_200,
            read=lambda: self.waiting.pop(0) if self.waiting else b"",
            write=lambda data: self.written.append((data, self.timeline.now_ns)),
        )
        self.driver = CurrentDriver(
            self.timeline,
            port,
            limits,
            lag_s=LAG_S,
            note=lambda event, **facts: self.events.append((event, facts)),
            acting=self.acting,
        )
        self._sequence = 0
        self.run(10)

    def run(self, ms):
        self.timeline.run_to(self.timeline.now_ns + round(ms * MILLISECOND))

    def send(self, x_ma=0, y_ma=0, flags=Flag.RUN):
        self._sequence += 1
        self.waiting.append(encode_command(FieldCommand(self._sequence, flags, x_ma, y_ma)))
        self.driver.read_port()

    def hold(self, seconds, x_ma, y_ma):
        """Send the same currents every 100 ms."""
        for _ in range(round(seconds * 10)):
            self.send(x_ma, y_ma)
            self.run(100)

    def replies(self):
        splitter = FrameSplitter()
        frames = [frame for data, _ in self.written for frame in splitter.feed(data)]
        return [decode_reply(frame) for frame in frames]

    def poll(self):
        """What the driver answers to a poll now."""
        self.written.clear()
        self.send(flags=Flag.RUN | Flag.POLL)
        self.run(10)
        (reply,) = self.replies()
        return reply


def test_currents_follow_their_set_points_with_the_lag_of_the_coils():
    made = Driver()
    made.send(1000, -500)
    made.run(1)  # the command takes about a millisecond on the line
    began_ns = made.timeline.now_ns
    while made.driver.currents == (0.0, 0.0):
        made.run(1)
    started = made.driver.currents
    assert made.timeline.now_ns - began_ns <= 4 * MILLISECOND
    made.run(8)
    x, y = made.driver.currents
    left = math.exp(-0.008 / LAG_S)
    assert x == pytest.approx(1.0 - (1.0 - started[0]) * left, rel=1e-6)
    assert y == pytest.approx(-0.5 - (-0.5 - started[1]) * left, rel=1e-6)
    made.hold(0.3, 1000, -500)
    assert made.driver.currents == pytest.approx((1.0, -0.5))
    assert made.driver.running


def test_currents_fall_to_zero_once_the_watchdog_has_expired():
    made = Driver()
    made.hold(0.3, 1000, 1000)
    made.run(140)
    assert made.driver.running
    made.run(200)
    assert not made.driver.running
    assert made.driver.status == DriverStatus.SILENT
    assert max(map(abs, made.driver.currents)) < 1e-3


def test_time_that_is_less_than_a_millisecond_is_made_up_later():
    made, smooth = Driver(), Driver()
    for each, step_ms in ((made, 0.7), (smooth, 1.0)):
        each.send(1000, 0)
        for _ in range(round(70 / step_ms)):
            each.run(step_ms)
    assert made.driver.currents == pytest.approx(smooth.driver.currents, rel=1e-6)


def test_a_driver_answers_a_poll_with_what_it_measures_and_its_limits():
    made = Driver()
    made.hold(0.3, 1000, -500)
    reply = made.poll()
    assert (reply.supply_mv, reply.temperature_dc) == (12_000, 250)
    assert (reply.current_max_ma, reply.slew_ma_s, reply.watchdog_ms) == (2000, 1_000_000, 250)
    made.send(1000, -500, Flag.RUN)
    made.run(50)
    made.written.clear()
    made.send(1000, -500, Flag.RUN | Flag.POLL)
    made.run(10)
    (reply,) = made.replies()
    assert (reply.x_ma, reply.y_ma) == pytest.approx((1000, -500), abs=2)


@pytest.mark.parametrize(
    ("fault", "field", "value"),
    [
        ({"name": "low_supply", "millivolts": 9000}, "supply_mv", 9000),
        ({"name": "hot", "celsius": 41.3}, "temperature_dc", 413),
    ],
)
def test_a_fault_changes_what_the_driver_measures_until_it_ends(fault, field, value):
    made = Driver()
    usual = getattr(made.poll(), field)
    acting = act(made.acting, fault.pop("name"), **fault)
    made.run(5)
    assert getattr(made.poll(), field) == value
    made.acting.remove(acting)
    made.run(5)
    assert getattr(made.poll(), field) == usual


def test_a_hot_driver_stays_stopped_until_it_is_switched_off_and_on():
    made = Driver()
    hot = act(made.acting, "hot", celsius=90.0)
    made.hold(0.2, 1000, 0)
    made.acting.remove(hot)
    made.hold(0.2, 1000, 0)
    assert DriverStatus.HOT in made.driver.status
    assert not made.driver.running
    made.driver.switch(False)
    assert made.driver.status == DriverStatus.SILENT
    made.driver.switch(True)
    made.hold(0.2, 1000, 0)
    assert made.driver.running


def test_a_driver_that_is_off_hears_nothing_and_its_currents_fall():
    made = Driver()
    made.hold(0.3, 1000, 1000)
    made.driver.switch(False)
    made.written.clear()
    made.send(1000, 0, Flag.RUN | Flag.POLL)
    made.run(100)
    assert made.written == []
    assert max(map(abs, made.driver.currents)) < 1e-3
    assert not made.driver.running


def test_a_mute_driver_obeys_and_does_not_reply():
    made = Driver()
    act(made.acting, "mute")
    made.send(1000, 0, Flag.RUN | Flag.POLL)
    made.run(50)
    assert made.written == []
    assert made.driver.currents[0] == pytest.approx(1.0, abs=0.01)


def test_a_doubled_command_is_received_twice_and_answered_once():
    made = Driver()
    before = made.poll().received
    doubled = act(made.acting, "doubled_commands")
    made.poll()
    made.acting.remove(doubled)
    assert made.poll().received == before + 3


def test_a_late_driver_hears_late_by_all_faults_and_in_the_order_of_what_was_sent():
    made = Driver()
    first = act(made.acting, "late_driver", by=0.05)
    second = act(made.acting, "late_driver", by=0.03)
    made.send(1000, 0)
    made.run(75)
    assert made.driver.currents == (0.0, 0.0)
    made.acting.remove(first)
    made.acting.remove(second)
    made.send(0, 700)  # it must not overtake the first
    made.run(3)
    assert made.driver.currents == (0.0, 0.0)
    made.run(50)
    assert made.driver.currents == pytest.approx((0.0, 0.7), abs=1e-3)


def test_each_command_is_recorded_as_it_is_sent():
    made = Driver()
    made.send(1000, -500)
    ((event, facts),) = made.events
    assert event == "command"
    assert facts == {"sequence": 1, "flags": Flag.RUN, "currents_ma": [1000, -500]}


@pytest.fixture
def dish():
    with virtual_dish(None) as lab:
        yield lab.emulation


@pytest.mark.slow
def test_a_cell_that_a_fault_names_divides_or_dives(dish):
    device = dish.actuator
    names = [body.name for body in device.bodies]
    depth = device.dish.cells.depth.copy()
    KINDS["dives"].begin(SimpleNamespace(cell=names[1], by_um=250.0), device)
    off = device.dish.cells.depth - depth
    assert off[1] == pytest.approx(250.0)
    assert not off[0]
    assert device.truth["born"] == []
    KINDS["divides"].begin(SimpleNamespace(cell=names[1]), device)
    ((x, y, _),) = device.truth["born"]
    mother = device.bodies[1]
    assert math.hypot(x - mother.x, y - mother.y) < 0.1
    with pytest.raises(UsageError, match="no cell has this name") as error:
        KINDS["dives"].begin(SimpleNamespace(cell="nobody", by_um=1.0), device)
    assert names[0] in error.value.hint


@pytest.mark.slow
def test_the_truth_has_the_currents_and_the_field_that_they_make(dish):
    device = dish.actuator
    device.driver.currents = (0.123456789, -0.5)
    truth = device.truth
    assert truth["currents_a"] == [0.12346, -0.5]
    assert truth["field_mt"] == pytest.approx(device.dish.field_mt, abs=1e-5)
    assert not device.driven
    device.switch(False)
    assert not device.driver.powered
    device.switch(True)
    assert device.driver.powered


@pytest.mark.slow
def test_the_limits_of_the_driver_are_those_of_the_spec():
    sets = ("lab.actuator.current_max_a=1.5", "lab.actuator.slew_max_a_s=7.5")
    with virtual_dish(None, sets=(*sets, "lab.actuator.watchdog=0.4")) as lab:
        limits = lab.emulation.actuator.driver._limits
    assert limits == DriverLimits(current_max_ma=1500, slew_ma_s=7500, watchdog_ms=400)
