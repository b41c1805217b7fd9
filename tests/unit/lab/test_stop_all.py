"""Tests of `lab stop` for robots with a port each: a missing robot does not delay the others."""

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from tetractl.cli import lab
from tetractl.core.clock import VirtualClock
from tetractl.core.errors import AbortError, Exit
from tetractl.lab.actuators import own_robots
from tetractl.lab.actuators.own_section import OwnSection
from tetractl.lab.actuators.twist import line_ports
from tetractl.lab.actuators.twist.section import TwistSection
from tetractl.lab.serial_port import PortHeldError
from tetractl.spec.lab_section import ActuatorSection

SETUP = SimpleNamespace(
    names=("green", "blue"),
    wheel_radius=40.0,
    metres=1e-3,
    a=np.full(2, 3.0),
    speed=np.full(2, 100.0),
    lag_s=0.0,
)


class Ports:
    """Ports in memory: those `away` cannot be opened, those `held` only if not alone, and those
    `stuck` take nothing."""

    def __init__(self, away=(), held=(), stuck=()):
        self.away = away
        self.held = held
        self.stuck = stuck
        self.taken = {}
        self.open = set()

    def __call__(self, name, *_):
        return Port(self, name)


class Port:
    def __init__(self, ports, name):
        self.failure = None
        self.refusal = None
        self._ports = ports
        self._name = name

    def open(self, alone=True):
        if self._name in self._ports.held and alone:
            raise PortHeldError(self._name)
        if self._name in self._ports.away:
            raise AbortError(f"{self._name}: there is no such port")
        self._ports.open.add(self._name)

    def is_ready(self):
        return True

    def write(self, data):
        if self._name not in self._ports.open:
            raise AbortError(f"{self._name} is not open")
        if self._name in self._ports.stuck:
            self.failure = f"{self._name} is stuck"
            raise AbortError(self.failure)
        self._ports.taken.setdefault(self._name, []).append(data)
        return 0

    def close(self):
        self._ports.open.discard(self._name)


class Own(own_robots.OwnRobots):
    def packed(self, row, left, right):
        return b"%d %d" % (left, right)


class OwnRobotsSection(OwnSection):
    device = f"{__name__}:{Own.__name__}"
    type: str = "own"


def own():
    robots = [{"name": "green", "address": "a"}, {"name": "blue", "address": "b"}]
    return OwnRobotsSection.model_validate({"robots": robots})


def twist():
    robots = [{"name": "green"}, {"name": "blue", "port": "b"}]
    return TwistSection.model_validate({"type": "twist", "port": "a", "robots": robots})


@pytest.fixture(params=[own, twist])
def stopped(request, monkeypatch):
    """Return what `lab stop` does at ports: what it says, or its error."""

    def stop(ports, alone=True):
        for module in (own_robots, line_ports):
            monkeypatch.setattr(module, "open_port", ports)
        try:
            return request.param().stop_all(SETUP, VirtualClock(), alone)
        finally:
            assert not ports.open

    return stop


def test_each_robot_gets_ten_stops(stopped):
    ports = Ports()
    assert stopped(ports).startswith("sent 10 stops")
    assert {name: len(lines) for name, lines in ports.taken.items()} == {"a": 10, "b": 10}


@pytest.mark.parametrize("away", ["a", "b"])
def test_a_robot_that_is_away_is_named_and_the_other_gets_its_stops(stopped, away):
    """Regression: nothing was sent if one of the ports could not be opened."""
    ports = Ports(away=away)
    with pytest.raises(AbortError, match=f"but not to all robots: {away}: there is no such port"):
        stopped(ports)
    (lines,) = ports.taken.values()
    assert len(lines) == 10


def test_a_port_that_is_stuck_ends_no_other_stop(stopped):
    ports = Ports(stuck="a")
    with pytest.raises(AbortError, match="but not to all robots: a is stuck"):
        stopped(ports)
    assert len(ports.taken["b"]) == 10


def test_no_port_at_all_is_an_error(stopped):
    with pytest.raises(AbortError, match=r"^a: there is no such port"):
        stopped(Ports(away="ab"))


def test_a_run_that_has_a_port_is_ended_first_and_stops_are_sent_beside_it(stopped):
    """Regression: robots by `OwnRobots` got no stop while a run had their ports."""
    ports = Ports(held="b")
    with pytest.raises(PortHeldError):
        stopped(ports)
    assert stopped(ports, alone=False).startswith("sent 10 stops")
    assert len(ports.taken["b"]) == 10


@pytest.fixture
def command(monkeypatch, stopped):
    """Return what does `lab stop` at ports, and returns its exit code and the ports of the runs
    that it ended; a run that is ended releases its port, unless it is one of `retaken`."""

    def lab_stop(ports, retaken=()):
        ended = []

        def end(port, stops, say):
            stops()
            ended.append(port)
            if port not in retaken:
                ports.held.remove(port)

        monkeypatch.setattr(lab, "_find_stop_function", lambda *_: partial(stopped, ports))
        monkeypatch.setattr(lab, "stop_and_end_holder", end)
        return lab.stop(), ended

    return lab_stop


def test_each_of_two_runs_is_ended_before_the_last_stops(command):
    """Regression: only the run that had the first port was ended. The last ten stops were sent to
    no robot, as the second run had a port, and it drove on."""
    ports = Ports(held={"a", "b"})
    code, ended = command(ports)
    assert code == Exit.DONE
    assert ended == ["a", "b"]
    # ten while each of two runs had a port, and ten when no run has a port any more
    assert len(ports.taken["a"]) == len(ports.taken["b"]) == 30


def test_a_port_that_another_run_takes_at_once_ends_the_command(command):
    with pytest.raises(PortHeldError):
        command(Ports(held={"a"}), retaken="a")


class StrangeActuator:
    """An actuator of a plug-in that sends to two robots; the first is lost after one stop."""

    stops_of_second = 0

    def __init__(self, *_):
        type(self).stops_of_second = 0

    def __enter__(self):
        return self

    def __exit__(self, *_): ...

    def stop(self, emergency):
        type(self).stops_of_second += 1
        if self.stops_of_second > 1:
            raise AbortError("the first robot is gone")


class StrangeSection(ActuatorSection):
    device = f"{__name__}:{StrangeActuator.__name__}"
    type: str = "strange"


def test_a_plug_ins_actuator_that_fails_once_is_asked_for_the_other_stops_too():
    """Regression: of an actuator without a `stop_all` of its own, the first error ended the stops
    to all robots."""
    with pytest.raises(AbortError, match="the first robot is gone"):
        StrangeSection(type="strange").stop_all(SETUP, VirtualClock())
    assert StrangeActuator.stops_of_second == 10
