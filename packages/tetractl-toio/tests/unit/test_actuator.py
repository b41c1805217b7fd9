"""Tests of the commands that the actuator sends to cubes, on ports in memory."""

import numpy as np
import pytest
from testkit.cli import tetractl
from tetractl_toio.actuator import CHARGE_MIN
from tetractl_toio.messages import (
    SPEED_MIN,
    WHEEL_MM_S,
    Characteristic,
    Unpacker,
    decode_motor,
    pack,
)

from tetractl.core.clock import VirtualClock
from tetractl.core.commands import Steer
from tetractl.core.poses import Pose
from tetractl.lab.serial_port import SerialPort
from tetractl.spec.load import load_spec


class Wire(SerialPort):
    """A port that keeps what is written to it; one of a name in `broken` takes nothing."""

    written: dict
    broken: set
    charges: dict

    def open(self, alone=True):
        self.written[self._name] = Unpacker(), []

    def write(self, data):
        if self._name in self.broken:
            raise self._fail("is gone")
        unpacker, messages = self.written[self._name]
        messages += unpacker.feed(data)
        charge = self.charges.get(self._name)  # None if the cube does not answer
        if charge is not None and data[0] == Characteristic.BATTERY:
            answer = pack(Characteristic.BATTERY, bytes([charge]))
            self._on_received(answer, self._clock.now())
        return self._clock.now()

    def close(self):
        pass


@pytest.fixture
def cubes(tmp_path):
    """An actuator of three cubes, and its ports."""
    tetractl(tmp_path, "init", "cubes", "--lab", "--robots", "toio").ok()
    experiment = load_spec(tmp_path / "cubes.yaml").experiment
    wire_class = type("Made", (Wire,), {"written": {}, "broken": set(), "charges": {}})
    from tetractl_toio.actuator import ToioActuator

    clock = VirtualClock()
    return ToioActuator(experiment.lab.actuator, experiment.setup, clock, wire_class), wire_class


def motors(wire, name):
    return [decode_motor(d) for c, d in wire.written[name][1] if c == Characteristic.MOTOR]


def test_slow_wheels_get_their_mean_speed_though_they_cannot_turn_slowly(cubes):
    actuator, _ = cubes
    wished = np.array([[3.0, -15.0, 80.0], [117.0, 15.0, 80.0]])  # mm/s
    steered = np.ones(3, bool)
    sent = np.array([actuator.outputs(wished, steered) for _ in range(400)])
    np.testing.assert_allclose(sent.mean(axis=0) * WHEEL_MM_S, wished, atol=0.1)
    assert set(np.unique(np.abs(sent[:, 0, 0]))) == {0, SPEED_MIN}
    is_driven = sent != 0
    slowest = np.abs(sent[is_driven]).min()
    assert slowest == SPEED_MIN
    too_fast = np.array([[400.0, 0, 0], [200.0, 0, 0]])
    fast = actuator.outputs(too_fast, steered)
    assert fast[:, 0].tolist() == [106, 53]  # 300 mm/s at most, on the same curve
    assert not fast[:, 1:].any()
    assert not actuator.outputs(np.zeros((2, 3)), steered).any()


def test_a_direction_becomes_motor_commands_that_end_by_themselves(cubes):
    actuator, wire = cubes
    with actuator:
        sent = actuator.send(Steer(0.9), [Pose(0.0, 0.0, 0.0)] * 3, (True, True, False), 0)
    (steered,) = motors(wire, "toio-M0p")
    (gone,) = motors(wire, "toio-C3P")
    assert steered.duration_ms == 250
    assert gone == (0, 0, 250)
    counts = np.array([steered.left, steered.right])
    np.testing.assert_allclose([sent.left[0], sent.right[0]], counts * WHEEL_MM_S)
    assert steered.right > steered.left >= 0


def statuses(cubes, charges):
    """The status of each robot, whose cubes answer these charges [%] or, if None, nothing."""
    actuator, wire = cubes
    names = [robot.cube for robot in actuator.section.robots]
    wire.charges = dict(zip(names, charges, strict=True))
    with actuator:
        return actuator.poll(0.5)


def test_a_cube_is_silent_empty_low_or_well(cubes):
    actuator, _ = cubes
    level = round(actuator.section.battery_warn)
    silent, empty, low = statuses(cubes, (None, CHARGE_MIN - 1, level - 1))
    assert "does not answer" in silent.problems[0]
    assert (silent.answers, silent.charge) == (False, None)
    assert f"is at {CHARGE_MIN - 1} %: charge it" in empty.problems[0]
    assert (empty.answers, empty.charge, empty.warnings) == (True, CHARGE_MIN - 1, ())
    assert f"is at {level - 1} %" in low.warnings[0]
    assert low.problems == ()


def test_a_cube_at_either_level_is_not_below_it(cubes):
    actuator, _ = cubes
    level = round(actuator.section.battery_warn)
    at_empty, at_level, full = statuses(cubes, (CHARGE_MIN, level, 100))
    assert at_empty.problems == ()
    assert len(at_empty.warnings) == (level > CHARGE_MIN)
    for well in (at_level, full):
        assert well.problems == well.warnings == ()
        assert well.answers
