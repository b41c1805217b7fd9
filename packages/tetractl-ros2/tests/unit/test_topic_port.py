"""Tests of topics used as ports, with fake partners."""

import contextlib
import struct

import pytest

pytest.importorskip("cyclonedds", reason="tetractl-ros2 needs cyclonedds")
from tetractl_ros2 import ros2_messages
from tetractl_ros2.ros2_messages import Twist, Vector3
from tetractl_ros2.topic_port import DISCOVERY_S, UNDECODABLE, Topic, TopicEnd, TopicPort
from tetractl_ros2.topics import COMMAND_MESSAGES, POSE_MESSAGES

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.errors import AbortError
from tetractl.lab.serial_port import UNREADABLE, PortGroup, stop_all_at
from tetractl.spec.lab_section import STOP_COUNT, STOP_GAP_NS

NAMES = ("green", "blue", "red")
DISCOVERY_NS = round(DISCOVERY_S * SECOND)


class PlayedEnd:
    """An end of a topic to which somebody subscribes at a time of the clock [ns]; None: nobody."""

    def __init__(self, topic, clock, appears_ns):
        self.topic = topic
        self.sent_ns = []
        self._clock = clock
        self._appears_ns = appears_ns

    def open(self):
        pass

    def close(self):
        pass

    @property
    def n_partners(self):
        return int(self._appears_ns is not None and self._clock.now() >= self._appears_ns)

    def publish(self, data):
        if self.n_partners:
            self.sent_ns.append(self._clock.now())


@pytest.fixture
def ports_to(monkeypatch):
    """Make a port for each time at which a robot subscribes; at the end they are closed."""
    monkeypatch.setattr("tetractl_ros2.topic_port.lock_address", lambda name: None)
    with contextlib.ExitStack() as closing:

        def make(*appear_ns):
            clock = VirtualClock()
            ports = []
            for name, appears_ns in zip(NAMES, appear_ns, strict=True):
                topic = Topic(f"/{name}/cmd_vel", Twist, publishes=True)
                address = topic.address(0)
                port = TopicPort(topic, address, 0, name, clock, lambda *_: None, "hint")
                port.end = PlayedEnd(topic, clock, appears_ns)
                closing.callback(port.close)
                ports.append(port)
            return clock, ports

        yield make


def test_topics_to_which_nobody_subscribes_are_waited_for_at_the_same_time(ports_to):
    """Regression: each of them was waited for after the others."""
    clock, ports = ports_to(None, SECOND, None)
    PortGroup(ports).open()
    assert clock.now() == DISCOVERY_NS
    assert [port.refusal for port in ports] == [
        "no node subscribes to /green/cmd_vel",
        None,
        "no node subscribes to /red/cmd_vel",
    ]


def test_robots_that_are_there_are_not_waited_for(ports_to):
    clock, ports = ports_to(0, 0, 0)
    PortGroup(ports).open()
    assert clock.now() == 0


def test_stops_are_sent_to_whoever_is_there_while_others_are_waited_for(ports_to):
    """Regression: before the first stop, each silent topic was waited for."""
    clock, ports = ports_to(None, SECOND, 0)
    link = PortGroup(ports)
    with pytest.raises(AbortError) as caught:
        stop_all_at(ports, lambda: link.send([Twist().serialize()] * 3), clock, alone=True)
    not_to = "no node subscribes to /green/cmd_vel"
    assert caught.value.message == f"sent {STOP_COUNT} stops, but not to all robots: {not_to}"
    silent, late, prompt = (port.end.sent_ns for port in ports)
    end_ns = DISCOVERY_NS + STOP_COUNT * STOP_GAP_NS
    assert clock.now() == end_ns
    assert silent == []
    assert late == list(range(SECOND, end_ns, STOP_GAP_NS))
    assert prompt == list(range(0, end_ns, STOP_GAP_NS))


def test_robots_that_are_all_there_get_ten_stops(ports_to):
    clock, ports = ports_to(0, 0, 0)
    link = PortGroup(ports)
    sent = stop_all_at(ports, lambda: link.send([Twist().serialize()] * 3), clock, alone=True)
    assert sent == f"sent {STOP_COUNT} stops"
    assert [len(port.end.sent_ns) for port in ports] == [STOP_COUNT] * 3


class Arrivals:
    """A reader of a topic and what it waits for: messages, or errors that their decoding raises."""

    def __init__(self, *came):
        self._came = list(came)

    def wait(self, timeout_ns):
        pass

    def take(self, count):
        taken = [self._came.pop(0) for _ in range(min(count, len(self._came)))]
        for message in taken:
            if isinstance(message, Exception):
                raise message
        return taken


def twist(x):
    return Twist(linear=Vector3(x=x))


def test_a_message_that_cannot_be_decoded_loses_no_other():
    """Regression: its exception ended the port's thread, and with it the trial."""
    end = TopicEnd(Topic("/green/cmd_vel", Twist), 0)
    end._arrivals = end._reader = Arrivals(twist(1.0), struct.error("unpack"), twist(2.0))
    assert end.wait() == [twist(1.0).serialize(), UNDECODABLE, twist(2.0).serialize()]


@pytest.mark.parametrize("name", [*POSE_MESSAGES, *COMMAND_MESSAGES, "BatteryState", "Bool"])
def test_no_kind_of_message_can_be_decoded_from_the_bytes_that_stand_for_such_a_message(name):
    with pytest.raises(UNREADABLE):
        getattr(ros2_messages, name).deserialize(UNDECODABLE)


def test_a_topic_that_is_not_open_takes_no_message():
    with pytest.raises(AbortError, match="/green/cmd_vel is not open"):
        TopicEnd(Topic("/green/cmd_vel", Twist, publishes=True), 0).publish(twist(1.0).serialize())
