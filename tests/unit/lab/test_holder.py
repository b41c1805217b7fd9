"""Tests of how `lab stop` ends the process that uses the port, with real processes."""

import os
import signal
import subprocess
import sys
import tty

import pytest
from testkit.running import PATIENCE_S, TETRACTL, environment

from tetractl.core.clock import MonotonicClock
from tetractl.core.errors import AbortError
from tetractl.lab import port_holder as module
from tetractl.lab.port_holder import command_line, find_holder, stop_and_end_holder
from tetractl.lab.serial_port import PortHeldError, SerialPort

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="needs Linux's /proc/locks"),
]
HOLDS = """
import serial, signal, sys
held = serial.Serial(sys.argv[1], exclusive=True)
if "deaf" in sys.argv:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
print("held", flush=True)
while True:
    signal.pause()
"""


@pytest.fixture
def port():
    near, far = os.openpty()
    tty.setraw(far)
    yield os.ttyname(far)
    os.close(near)
    os.close(far)


@pytest.fixture
def hold(tmp_path, port):
    """Start a program of a name that has the port for itself."""
    started = []

    def start(name, *words):
        (tmp_path / name).write_text(HOLDS)
        process = subprocess.Popen(
            [sys.executable, tmp_path / name, port, *words], stdout=subprocess.PIPE
        )
        started.append(process)
        assert process.stdout.readline() == b"held\n"
        return process

    yield start
    for process in started:
        process.kill()
        process.wait()
        process.stdout.close()


def stopping(port):
    """Stop next to the holder; return what was said."""
    said = []
    stop_and_end_holder(port, lambda: "sent stops", said.append)
    return "\n".join(said)


def test_the_holder_of_a_port_is_known(port, hold):
    assert find_holder(port) is None
    process = hold("tetractl")
    assert find_holder(port) == process.pid
    assert command_line(process.pid)[2] == port


@pytest.mark.parametrize("suspended", [False, True])
def test_a_run_is_asked_to_end_even_when_suspended(port, hold, suspended):
    process = hold("tetractl")
    if suspended:
        process.send_signal(signal.SIGSTOP)
    said = stopping(port)
    assert process.wait() == -signal.SIGTERM
    assert f"{port}: process {process.pid} (" in said
    assert "asked the process to stop its robots and to end" in said
    assert "sent stops, while this process has the port open" in said
    assert "the process released the port" in said


def test_a_run_that_hears_nothing_is_killed(port, hold, monkeypatch):
    sooner = [(number, did, until_s / 20) for number, did, until_s in module.ENDING_SIGNALS]
    monkeypatch.setattr(module, "ENDING_SIGNALS", sooner)
    process = hold("tetractl", "deaf")
    said = stopping(port)
    assert process.wait() == -signal.SIGKILL
    assert said.index("asked the process to end at once") < said.index("killed the process")


def test_stops_are_sent_before_anything_is_said(port, hold):
    """Regression: a terminal that hung took the first line, and neither a signal nor a stop went
    out."""
    hold("tetractl")
    events = []

    def stops():
        events.append("stops")
        return "sent stops"

    stop_and_end_holder(port, stops, events.append)
    assert events[0] == "stops"
    assert "has this port open" in events[1]


@pytest.mark.long
def test_lab_stop_ends_a_run_although_nobody_reads_its_stdout(port, hold):
    """Regression: `lab stop | head -1` ended with exit code 0 at its first line, without a signal
    to the run, and without one stop."""
    process = hold("tetractl")
    reading, writing = os.pipe()
    os.close(reading)
    stop = subprocess.run(
        [TETRACTL, "lab", "stop", "--port", port],
        env=environment(),
        stdin=subprocess.DEVNULL,
        stdout=writing,
        stderr=subprocess.PIPE,
        text=True,
        timeout=PATIENCE_S,
    )
    os.close(writing)
    assert stop.returncode == 1  # as no radio is at this port
    assert "no XBee module answers" in stop.stderr
    assert process.poll() == -signal.SIGTERM
    assert "the process released the port" in stop.stderr


def test_another_program_is_named_and_left_alone(port, hold):
    process = hold("terminal")
    with pytest.raises(AbortError, match=f"process {process.pid} .* is not a tetractl") as raised:
        stopping(port)
    assert "switch the robots off" in raised.value.hint
    assert process.poll() is None


def test_another_users_run_is_named_and_left_alone(port, hold, monkeypatch):
    def forbidden(pid, number):
        raise PermissionError

    process = hold("tetractl")
    monkeypatch.setattr(os, "kill", forbidden)
    with pytest.raises(AbortError, match="cannot be ended, because it belongs to another user"):
        stopping(port)
    monkeypatch.undo()
    assert process.poll() is None


def test_a_held_port_takes_bytes_of_a_second_opener_that_asks_for_that(port, hold):
    hold("terminal")
    opener = SerialPort(port, 57600, "the radio", MonotonicClock(), lambda data, t: None, "")
    with pytest.raises(PortHeldError, match="another program has this port open"):
        opener.open()
    opener.open(exclusive=False)
    try:
        assert opener.write(b"stop") > 0
    finally:
        opener.close()


def test_that_no_stop_could_be_sent_next_to_another_program_is_said(port, hold):
    """Regression: the error named the program alone, as if its robots had been sent stops."""
    hold("terminal")

    def refused():
        raise AbortError("the radio is stuck")

    with pytest.raises(
        AbortError, match="so it is not ended; the stops failed as well: the radio is stuck"
    ):
        stop_and_end_holder(port, refused, lambda line: None)


def test_a_holder_that_is_not_known_is_sent_stops_over_and_told_of(port, hold, monkeypatch):
    process = hold("tetractl")
    monkeypatch.setattr(module, "find_holder", lambda port: None)
    with pytest.raises(AbortError, match="another program still has the port"):
        stopping(port)
    assert process.poll() is None
