"""Tests of ports that another program feeds: what arrives, and how a failure is reported."""

import threading

import pytest
from testkit.hand_clock import HandClock

from tetractl.core.clock import SECOND
from tetractl.core.errors import AbortError
from tetractl.lab.client_port import ClientPort

PATIENCE_S = 60


class Client(ClientPort):
    """A port whose messages are in a list; `at_end` is done after the last."""

    def __init__(self, messages=(), at_end=None, refuses=None):
        self.received = []
        self.ended = threading.Event()
        self.calls = []
        self.clock = HandClock()
        self.clock.sleep_until(5 * SECOND)
        super().__init__("a name", 0, "the camera", self.clock, self.hear, "a hint")
        self.messages = list(messages)
        self.at_end = at_end or self._closing.set
        self.refuses = refuses

    def hear(self, data, now_ns):
        self.received.append((data, now_ns))

    def connect(self):
        self.calls.append("connect")
        if self.refuses:
            raise self.refuses

    def wait(self):
        self.calls.append("wait")
        if self.messages:
            self.take(*self.messages.pop(0))
        else:
            self.at_end()

    def disconnect(self):
        self.calls.append("disconnect")
        self.ended.set()
        raise OSError("an exception that nobody needs")

    def run(self):
        self.open()
        assert self.ended.wait(PATIENCE_S)
        self.close()
        return self


def raising(error):
    def at_end():
        raise error

    return at_end


def test_each_message_is_passed_on_with_the_time_at_which_it_arrived():
    port = Client([(b"one",), (b"two", 3 * SECOND)]).run()
    assert port.received == [(b"one", 5 * SECOND), (b"two", 2 * SECOND)]
    assert port.calls == ["connect", "wait", "wait", "wait", "disconnect"]
    assert (port.failure, port.name) == (None, "a name")


@pytest.mark.parametrize(
    ("error", "failure"),
    [
        (AbortError("the pipe broke"), "the pipe broke"),
        (RuntimeError("no licence"), "the camera: no licence"),
        (KeyError(), "the camera: KeyError"),
    ],
)
@pytest.mark.parametrize("when", ["connecting", "waiting"])
def test_an_exception_is_a_failure_that_is_told_once(error, failure, when):
    port = Client(refuses=error) if when == "connecting" else Client(at_end=raising(error))
    port.run()
    assert port.failure == failure
    assert port.received == [(b"", 5 * SECOND)]
    assert port.calls.count("disconnect") == 1
    with pytest.raises(AbortError, match=failure) as caught:
        port.write(b"x")
    assert caught.value.hint == "a hint"


def test_a_connection_that_a_library_reports_as_lost_ends_the_port():
    port = Client()
    port.at_end = lambda: port.lost("unplugged")
    port.run()
    assert port.failure == "the camera: unplugged"
    assert port.received == [(b"", 5 * SECOND)]
    assert port.calls == ["connect", "wait", "disconnect"]


def test_an_exception_while_the_port_is_closed_is_no_failure():
    port = Client()

    def closing():
        port._closing.set()
        raise RuntimeError("interrupted")

    port.at_end = closing
    port.run()
    assert (port.failure, port.received) == (None, [])


def test_nothing_is_written_to_such_a_port_but_its_time_is_returned():
    assert Client().write(b"x") == 5 * SECOND
