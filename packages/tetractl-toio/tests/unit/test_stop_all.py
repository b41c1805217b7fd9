"""Tests of `tetractl lab stop` for cubes: a cube that is off does not keep the others from
stopping.
"""

import pytest
from testkit.cli import tetractl
from tetractl_toio import actuator
from tetractl_toio.messages import Characteristic, Unpacker, decode_motor

from tetractl.core.clock import VirtualClock
from tetractl.core.errors import AbortError
from tetractl.lab.serial_port import PortHeldError, SerialPort
from tetractl.spec.load import load_spec

GREEN = "toio-M0p"
BLUE = "toio-a9R"
RED = "toio-C3P"
TEN_STOPS = [(0, 0, 250)] * 10


class Lab:
    """Cubes that keep what is written to them: those that are `off` are not found, those `held`
    are connected only if not `alone`, and those `lost` take one message."""

    def __init__(self):
        self.off = set()
        self.held = set()
        self.lost = set()
        self.written = {}

    def port(self, *arguments):
        port = CubePort(*arguments)
        port.lab = self
        return port

    def motors(self, cube):
        """Return the motor commands to a cube."""
        messages = Unpacker().feed(b"".join(self.written[cube]))
        return [decode_motor(data) for kind, data in messages if kind == Characteristic.MOTOR]


class CubePort(SerialPort):
    """The connection to one of the lab's cubes; as over Bluetooth, one that is not found has a
    failure, too."""

    lab: Lab

    def open(self, alone=True):
        if self._name in self.lab.off:
            raise self._fail("was not found within 10 s")
        if self._name in self.lab.held and alone:
            raise PortHeldError(self._name)
        self.lab.written[self._name] = []

    def write(self, data):
        if self._name not in self.lab.written:
            raise AbortError(f"{self._name} is not connected")
        if self._name in self.lab.lost and self.lab.written[self._name]:
            raise self._fail("is gone: disconnected")
        self.lab.written[self._name].append(data)
        return self._clock.now()

    def close(self): ...


@pytest.fixture
def lab(monkeypatch):
    cubes = Lab()
    monkeypatch.setattr(actuator, "make_port", cubes.port)
    return cubes


@pytest.fixture
def stop(tmp_path, lab):
    """Return what stops the cubes of a new spec."""
    tetractl(tmp_path, "init", "cubes", "--lab", "--robots", "toio").ok()
    experiment = load_spec(tmp_path / "cubes.yaml").experiment

    def stop(alone=True):
        section = experiment.lab.actuator
        return section.stop_all(experiment.setup, VirtualClock(), alone)

    return stop


def test_each_cube_gets_ten_stops(lab, stop):
    assert stop() == "sent 10 stops"
    assert lab.motors(GREEN) == lab.motors(BLUE) == lab.motors(RED) == TEN_STOPS


def test_a_cube_that_is_off_is_named_and_the_others_get_their_stops(lab, stop):
    """Regression: no cube got a stop if one of them was not found, and the hint said that the cubes
    stop by themselves."""
    lab.off.add(BLUE)
    with pytest.raises(AbortError) as raised:
        stop()
    why = "the port toio-a9R of blue was not found within 10 s"
    assert raised.value.message == f"sent 10 stops, but not to all robots: {why}"
    assert raised.value.hint == "switch the robots off by hand if they move"
    assert lab.motors(GREEN) == lab.motors(RED) == TEN_STOPS


def test_a_cube_that_is_lost_ends_no_other_stop(lab, stop):
    """Regression: the other cubes got two stops, not ten."""
    lab.lost.add(GREEN)
    with pytest.raises(AbortError, match="not to all robots: the port toio-M0p of green is gone"):
        stop()
    assert lab.motors(BLUE) == lab.motors(RED) == TEN_STOPS


def test_cubes_that_a_run_has_are_sent_stops_beside_it(lab, stop):
    """Regression: nothing was sent to emulated cubes until the run that had them had ended."""
    lab.held.add(RED)
    with pytest.raises(PortHeldError):
        stop()
    assert stop(alone=False) == "sent 10 stops"
    assert lab.motors(GREEN) == lab.motors(BLUE) == lab.motors(RED) == TEN_STOPS


def test_of_two_cubes_that_are_off_both_are_named_and_the_third_gets_its_stops(lab, stop):
    """Regression: no cube got a stop. Had each of the two been counted twice, as not found and as
    failed, it would have been said that no robot was reached."""
    lab.off.update((GREEN, BLUE))
    with pytest.raises(AbortError, match=r"but not to all robots: .*toio-M0p.*; .*toio-a9R"):
        stop()
    assert lab.motors(RED) == TEN_STOPS
