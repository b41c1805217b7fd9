"""Tests of cameras that send messages to a port, from the other end of the port."""

import threading
import types

import pytest
from testkit.running import PATIENCE_S

from tetractl.cli.specs import build_template
from tetractl.core.clock import VirtualClock
from tetractl.core.errors import AbortError
from tetractl.core.poses import Pose
from tetractl.lab.cameras.port_camera import REQUEST, PortCamera
from tetractl.lab.client_port import ClientPort
from tetractl.spec.load import parse_spec


class Port:
    """Stands for a port whose other end answers with `messages` once it is asked."""

    def __init__(self, messages):
        self.messages = messages
        self.failure = None
        self.sent = []
        self.closed = False

    def made(self, name, baud, device, clock, heard, hint):
        self.heard = heard
        return self

    def open(self):
        pass

    def write(self, data):
        self.sent.append(data)
        for message in self.messages:
            self.heard(message, 1_000_000_000)

    def close(self):
        self.closed = True


class OneRobot(PortCamera):
    """Stands for a camera of one robot, whose messages are x, or x@seconds on its own clock."""

    def poses(self, message):
        x, _, _ = message.partition(b"@")
        return (Pose(float(x), 0.0, 0.0),)

    def stamp_s(self, message):
        _, _, stamp = message.partition(b"@")
        return float(stamp) if stamp else None


SECTION = types.SimpleNamespace(address="there", latency=0.02)
SETUP = parse_spec(build_template("check", "check"), "check").experiment.setup.select_robots([0])


def camera(port, make=OneRobot):
    return make(SECTION, SETUP, VirtualClock(), ports=port.made)


def test_a_frame_was_exposed_the_latency_before_its_message_came():
    port = Port([b"7", b"no number", b"8"])
    with camera(port) as opened:
        first, second = opened.frames()
        assert opened.frames() == []
    assert port.sent == [REQUEST] and port.closed
    assert (first.poses, first.sampled_ns, first.received_ns) == (
        (Pose(7.0, 0.0, 0.0),), 980_000_000, 1_000_000_000,
    )  # fmt: skip
    assert (second.number, opened.damaged) == (2, 1)


def test_a_port_that_fails_is_a_frame_whose_fault_aborts_the_trial():
    port = Port([b"7"])
    with camera(port) as opened:
        opened.frames()
        port.failure = "the port is gone"
        port.heard(b"", 2_000_000_000)
        (frame,) = opened.frames()
    assert (frame.fault, frame.poses) == ("the port is gone", (None,))


@pytest.mark.parametrize("failure", [None, "the port is gone"])
def test_a_camera_that_sends_nothing_or_has_failed_is_not_entered(failure):
    port = Port([])
    port.failure = failure
    with pytest.raises(AbortError, match=failure or "no camera frame came"), camera(port):
        pass
    assert port.closed


def test_messages_that_cannot_be_read_are_counted_and_the_first_is_shown():
    """Regression: they looked like silence."""
    with pytest.raises(AbortError, match=r"2 messages came .*ValueError.*b'nothing'"):
        camera(Port([b"nothing", b"again"])).__enter__()

    class TwoRobots(OneRobot):
        """Stands for a camera that gives a pose too many."""

        def poses(self, message):
            return (*super().poses(message), None)

    with pytest.raises(AbortError, match=r"ValueError: 2 poses, not 1"):
        camera(Port([b"7"]), TwoRobots).__enter__()


def test_times_on_the_cameras_own_clock_say_which_frames_came_late():
    port = Port([b"7@100.000"])  # 99 s ahead of ours: the first took `latency`
    with camera(port) as opened:
        port.heard(b"7@100.010", 1_015_000_000)  # 5 ms later than the first
        port.heard(b"7@100.020", 1_017_000_000)  # 3 ms quicker: from now on the least
        port.heard(b"7@100.030", 1_030_000_000)
        ages = [frame.received_ns - frame.sampled_ns for frame in opened.frames()]
    assert [round(age / 1e6) for age in ages] == [20, 25, 20, 23]


def test_a_client_that_fails_is_said_and_released():
    messages = []
    releases = []
    is_released = threading.Event()

    class Client(ClientPort):
        """Stands for a client that gives its name as its first message, and then fails."""

        def connect(self):
            self.take(self.name.encode())

        def wait(self):
            raise OSError("server gone")

        def disconnect(self):
            releases.append(self.name)
            is_released.set()

    def hear(message, received_ns):
        messages.append(message)

    settings = "there", 0, "the camera", VirtualClock(), hear, ""
    Client(*settings).close()  # one that was never opened has nothing to release
    port = Client(*settings)
    port.open()
    assert is_released.wait(PATIENCE_S)
    port.close()
    with pytest.raises(AbortError, match="the camera: server gone"):
        port.write(b"")
    assert releases == ["there"]
    assert messages == [b"there", b""]


class Named(OneRobot):
    """Stands for a camera that says of every message that it is a name it does not know."""

    def poses(self, message):
        raise KeyError(message.decode())


def test_what_a_sender_chose_is_bounded_in_the_error():
    """Regression: a name of 600 characters was printed whole."""
    with pytest.raises(AbortError) as refused, camera(Port([b"n\x1b" * 300]), Named):
        pass
    assert len(refused.value.message) < 700
    assert refused.value.message.isprintable()
