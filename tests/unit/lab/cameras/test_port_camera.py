"""Cameras that send messages to a port, at the other end of it."""

import pytest

from tetractl.core.clock import VirtualClock
from tetractl.core.errors import AbortError
from tetractl.core.poses import Pose
from tetractl.lab.cameras.port_camera import ASKED, PortCamera


class Port:
    """A port whose other end answers with `messages` once it is asked."""

    def __init__(self, messages):
        self.messages, self.failure, self.sent, self.closed = messages, None, [], False

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
    def poses(self, message):
        return (Pose(float(message), 0.0, 0.0),)


def camera(port):
    return OneRobot(1, "there", 0.02, VirtualClock(), lambda: None, port.made)


def test_a_frame_was_exposed_the_latency_before_its_message_came():
    port = Port([b"7", b"no number", b"8"])
    with camera(port) as opened:
        one, two = opened.frames()
        assert opened.frames() == []
    assert port.sent == [ASKED] and port.closed
    assert (one.poses, one.sampled_ns, one.received_ns) == (
        (Pose(7.0, 0.0, 0.0),), 980_000_000, 1_000_000_000,
    )  # fmt: skip
    assert (two.number, opened.damaged) == (2, 1)


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
