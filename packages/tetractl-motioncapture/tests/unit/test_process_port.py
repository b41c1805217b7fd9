"""Tests of reading the library's process: whole lines, their times, and why it has stopped."""

import io
import signal
import threading

import pytest
from testkit.hand_clock import HandClock
from tetractl_motioncapture import process_port
from tetractl_motioncapture.process_port import ProcessPort

from tetractl.core.clock import SECOND

PATIENCE_S = 60
HOST_NS = 1000 * SECOND
NOW_NS = 50 * SECOND


class Process:
    """Stands for the child process, which has printed these lines and ended with this code."""

    def __init__(self, lines, code, errors):
        self.stdout = io.BytesIO(b"".join(lines))
        self.code = code
        self.errors = errors
        self.killed = 0

    def wait(self):
        return self.code

    def error_lines(self):
        return self.errors

    def kill(self):
        self.killed += 1


@pytest.fixture
def reading(monkeypatch):
    """Read lines of a process until it has ended; return the port, the process and what came."""

    def read(*lines, code=0, errors=()):
        process = Process(lines, code, list(errors))
        made = []
        ended = threading.Event()
        received = []

        def hear(data, now_ns):
            received.append((data, now_ns))
            if not data:
                ended.set()

        def child(command, own_session):
            made.append((command, own_session))
            return process

        monkeypatch.setattr(process_port, "Child", child)
        monkeypatch.setattr(process_port, "host_ns", lambda: HOST_NS)
        clock = HandClock()
        clock.sleep_until(NOW_NS)
        port = ProcessPort('["vicon"]', 0, "the camera", clock, hear, "a hint")
        port.open()
        assert ended.wait(PATIENCE_S)
        port.close()
        port.close()
        (command, alone), *more = made
        assert not more and alone
        assert command[-2:] == ["tetractl_motioncapture.bridge", '["vicon"]']
        return port, process, received

    return read


def test_a_line_is_a_message_at_the_time_at_which_the_process_printed_it(reading):
    lines = [b"%d {a}\n" % HOST_NS, b"%d {b c}\n" % (HOST_NS - 3 * SECOND)]
    port, process, received = reading(*lines)
    assert received[:2] == [(b"{a}\n", NOW_NS), (b"{b c}\n", NOW_NS - 3 * SECOND)]
    assert received[2:] == [(b"", NOW_NS)]
    assert process.killed == 2
    assert process.stdout.closed
    assert port.name == '["vicon"]'


def test_a_line_of_the_future_has_just_arrived(reading):
    """The clocks of two processors may differ by a little."""
    _, _, received = reading(b"%d {}\n" % (HOST_NS + 5))
    assert received[0] == (b"{}\n", NOW_NS)


@pytest.mark.parametrize(
    ("code", "errors", "why"),
    [
        (0, [], "exit code 0"),
        (1, [], "exit code 1"),
        (2, ["a warning", "no connection"], "exit code 2: no connection"),
        (-signal.SIGKILL, ["a warning"], "Killed"),
        (-signal.SIGSEGV, [], "Segmentation fault"),
        (-63, [], None),
    ],
)
def test_the_end_of_the_process_is_a_failure_with_its_reason(reading, code, errors, why):
    port, _, _ = reading(code=code, errors=errors)
    head, _, reason = port.failure.partition(" has stopped: ")
    assert head == "the process that reads the camera"
    assert reason == (why or signal.strsignal(63) or "signal 63")


def test_a_port_that_was_never_opened_can_be_closed():
    port = ProcessPort("[]", 0, "the camera", HandClock(), lambda *_: None, "")
    port.disconnect()
    port.close()
    assert port.failure is None
