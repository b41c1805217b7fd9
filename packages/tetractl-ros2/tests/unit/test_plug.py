"""Tests of an emulated device's end of a topic, with a played end instead of a ROS 2 graph."""

import queue
import select
import threading
from dataclasses import dataclass
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds", reason="tetractl-ros2 needs cyclonedds")
from cyclonedds.core import DDSException
from tetractl_emulator.wires import Wires
from tetractl_ros2.emulated import plug
from tetractl_ros2.emulated.plug import TopicPlug, on_topics
from tetractl_ros2.ros2_messages import Twist
from tetractl_ros2.topic_port import Topic

from tetractl.core.errors import AbortError, TetractlError

NAME = "ros2://7/green/cmd_vel"


class PlayedEnd:
    """An end of a topic that passes on what a test puts into it."""

    def __init__(self, topic, domain):
        self.topic = topic
        self.domain = domain
        self.coming = queue.Queue()
        self.published = []
        self.idle = threading.Event()  # that all that came has been passed on
        self.is_open = False
        self.error = None

    def open(self):
        if self.error is not None:
            raise self.error
        self.is_open = True

    def close(self):
        self.is_open = False

    def wait(self):
        if self.coming.empty():
            self.idle.set()
        try:
            return [self.coming.get(timeout=0.01)]
        except queue.Empty:
            return []

    def publish(self, data):
        if self.error is not None:
            raise self.error
        self.published.append(data)


@pytest.fixture
def plugs(monkeypatch):
    """Return a function that makes a plug with its end; at the end all are unplugged."""
    monkeypatch.setattr(plug, "TopicEnd", PlayedEnd)
    made = []

    def make(publishes=False):
        one = TopicPlug(Topic("/green/cmd_vel", Twist, publishes=publishes), NAME)
        made.append(one)
        return one, one._end

    yield make
    for one in made:
        one.unplug()


def wait_for_data(device):
    """Wait until the loop of an emulation would be woken; 5 s at most."""
    assert select.select([device.fd], [], [], 5.0)[0]


def test_a_message_wakes_the_loop_and_is_read_once(plugs):
    device, end = plugs()
    device.plug()
    assert end.domain == 7
    assert device.read() == b""
    end.coming.put(b"one")
    wait_for_data(device)
    assert device.read() == b"one"
    assert device.read() == b""
    assert not select.select([device.fd], [], [], 0)[0]
    assert device.baud() is None


def test_a_stalled_topic_drops_what_comes_and_what_is_sent(plugs):
    device, end = plugs()
    device.plug()
    device.set_stalled(True)
    end.coming.put(b"lost")
    for _ in range(2):  # the second time, what was taken the first time has been passed on
        end.idle.clear()
        assert end.idle.wait(5.0)
    device.set_stalled(False)
    end.coming.put(b"heard")
    wait_for_data(device)
    assert device.read() == b"heard"
    assert device.read() == b""
    sender, out = plugs(publishes=True)
    sender.plug()
    sender.set_stalled(True)
    sender.write(b"lost")
    sender.set_stalled(False)
    sender.write(b"sent")
    assert out.published == [b"sent"]


def test_nothing_is_published_by_a_plug_that_is_pulled(plugs):
    device, end = plugs(publishes=True)
    device.write(b"early")
    device.plug()
    assert device.fd >= 0
    device.write(b"sent")
    device.unplug()
    device.unplug()
    device.write(b"late")
    assert end.published == [b"sent"]
    assert not end.is_open
    assert device.fd == -1


def test_a_publisher_has_no_thread_and_a_subscriber_has_one_until_it_is_unplugged(plugs):
    sender, _ = plugs(publishes=True)
    sender.plug()
    assert sender._thread is None
    device, _ = plugs()
    device.plug()
    thread = device._thread
    assert thread.is_alive()
    device.unplug()
    assert not thread.is_alive()
    device.plug()
    assert device._thread.is_alive()


def test_a_message_that_dds_does_not_take_is_lost(plugs):
    device, end = plugs(publishes=True)
    device.plug()
    end.error = DDSException(-1)
    device.write(b"lost")
    end.error = None
    device.write(b"sent")
    assert end.published == [b"sent"]


def test_a_topic_that_cannot_be_joined_is_an_error_of_the_emulation(plugs):
    device, end = plugs()
    end.error = AbortError("cannot join", "is the network up?")
    with pytest.raises(TetractlError, match="cannot join") as error:
        device.plug()
    assert error.value.hint == "is the network up?"
    assert device.fd == -1


@dataclass(frozen=True)
class Stage:
    """What of a stage is needed here."""

    wires: Wires


def test_only_a_lab_on_real_wires_gets_topics_of_a_graph(monkeypatch):
    monkeypatch.setattr(plug, "TopicEnd", PlayedEnd)
    topic = Topic("/green/cmd_vel", Twist)
    in_memory = Stage(Wires(ports=lambda *_: None))
    assert on_topics(in_memory, 7, [topic]) is in_memory
    real = on_topics(Stage(Wires()), 7, [topic])
    port = real.wires.port(NAME)
    assert isinstance(port, TopicPlug)
    assert port.name == NAME
    with pytest.raises(KeyError):
        real.wires.port(Path("elsewhere"))
