"""Tests of `tetractl lab check`, `stop`, `calibrate` and `tetractl run --plant lab`, emulated."""

import os
import signal
import subprocess

import pytest
from testkit.cli import process
from testkit.emulator.lab_processes import PATIENCE_S, SMALL, SPEC, TETRACTL, Emulator, flags
from testkit.terminal import Terminal

from tetractl.lab.cobs import Flag
from tetractl.log.read.reader import read_trial

pytestmark = pytest.mark.system

LONG = ("controller.time_limit=8.2", "lab.limits.placing=30", "robots.0.target=[1500, 500]")
LONGER = ("controller.time_limit=80.2", *LONG[1:])  # than another program takes to start


@pytest.fixture
def lab(tmp_path):
    """Start an emulated lab; returns it and the settings that lead to it."""
    gathered = []

    def start(script="", *options):
        if script:
            (tmp_path / "script.yaml").write_text(script)
            options = (*options, "--script", str(tmp_path / "script.yaml"))
        emulator = Emulator(tmp_path, SMALL, *options)
        gathered.append(emulator)
        ready = emulator.wait_for("ready")
        return emulator, (
            *SMALL,
            f"lab.camera.command_port={ready['command_port']}",
            f"lab.actuator.port={ready['port']}",
        )

    yield start
    for emulator in gathered:
        emulator.close()


def at_rest(record):
    """Whether the last that is recorded of each robot is that it stands."""
    last = [event["moving"] for event in record if event["event"] == "robot"][-3:]
    return last == [False] * 3


def test_a_person_is_asked_what_only_a_person_knows_of_the_radio(lab, tmp_path):
    _, settings = lab("about: an odd radio\nemulation: {actuator: {hardware: 0x7F44}}")
    command = [TETRACTL, "lab", "check", str(SPEC), *flags(settings)]
    with Terminal(command, tmp_path, columns=200) as terminal:
        terminal.expect(r"802\.15\.4 firmware\? \[y/N\]")
        terminal.press("n\n")
        assert terminal.finish() == 1


def go(emulator, terminal):
    """Press Enter whenever the run asks for it, until robots are driven.

    Enter is the consent to the lines that it follows: a frame lost on a busy host withdraws them,
    and the run then asks again. Regression: a test that pressed once waited for 300 s.
    """
    emulator.wait_for("run", lambda: terminal.answer("press Enter to start", "\r"))


def test_space_is_the_operators_emergency_stop(lab, tmp_path):
    emulator, settings = lab()
    sets = flags((*settings, *LONG))
    command = [TETRACTL, "run", str(SPEC), "--plant", "lab", "--out", "logs", "--quiet", *sets]
    with Terminal(command, tmp_path, columns=100) as terminal:
        terminal.expect("SPACE or ESC: EMERGENCY STOP")
        go(emulator, terminal)
        terminal.press(" ")
        assert terminal.finish() == 1
        assert "emergency stop by the operator" in terminal.raw
        assert terminal.settings() == terminal.before
    _, record = emulator.end()
    stops = [e for e in record if e["event"] == "command" and e["flags"] & 2]
    assert len(stops) >= 10
    assert at_rest(record)


@pytest.mark.parametrize("hangs", [False, True])
def test_a_terminal_that_is_closed_or_hangs_stops_no_stop(lab, tmp_path, hangs):
    """Regression: after a closed terminal no stop was sent, and the log was torn."""
    emulator, settings = lab()
    sets = flags((*settings, *LONG))
    command = [TETRACTL, "run", str(SPEC), "--plant", "lab", "--out", "logs", *sets]
    with Terminal(command, tmp_path, columns=100) as terminal:
        go(emulator, terminal)
        if hangs:  # the live view fills it at once
            terminal.fill()
            terminal.process.send_signal(signal.SIGINT)
        else:
            terminal.close()
        code = terminal.process.wait(PATIENCE_S)
    assert code == 130 if hangs else code in (1, 130)  # the signal or the lost key comes first
    trial = read_trial(tmp_path / "logs" / "trial-000.mcap")
    assert trial.damage is None
    assert trial.result.outcome == ("interrupted" if code == 130 else "aborted")
    assert len(trial.steps) < 40
    _, record = emulator.end()
    sent = [e["flags"] for e in record if e["event"] == "command"]
    assert not any(flags & Flag.RUN for flags in sent[-10:])
    assert at_rest(record)


def test_a_run_that_nobody_can_read_stops_its_robots(lab, tmp_path):
    """Regression: it drove on to its end, with no operator to stop it."""
    emulator, settings = lab()
    sets = flags((*settings, *LONG))
    command = [TETRACTL, "run", str(SPEC), "--plant", "lab", "--yes", "--out", "logs"]
    reading, writing = os.pipe()
    pipes = {"stdin": subprocess.DEVNULL, "stdout": writing, "stderr": writing}
    run = subprocess.Popen([*command, *sets], cwd=tmp_path, **pipes)
    os.close(writing)
    try:
        emulator.wait_for("moving")
        os.close(reading)
        assert run.wait(PATIENCE_S) == 130
    finally:
        run.kill()
        run.wait()
    assert read_trial(tmp_path / "logs" / "trial-000.mcap").result.outcome == "interrupted"
    assert at_rest(emulator.end()[1])


def test_stop_ends_the_suspended_run_that_has_the_port(lab, tmp_path):
    """Regression: it stopped nothing while a run, good or suspended, had the port."""
    emulator, settings = lab()
    sets = flags((*settings, *LONGER))
    command = [TETRACTL, "run", str(SPEC), "--plant", "lab", "--yes", "--out", "logs", *sets]
    with (tmp_path / "said").open("w") as said:
        run = subprocess.Popen(
            command, cwd=tmp_path, stdin=subprocess.DEVNULL, stdout=said, stderr=said
        )
    try:
        emulator.wait_for("moving")
        run.send_signal(signal.SIGSTOP)
        done = process(tmp_path, "lab", "stop", "--port", str(tmp_path / "radio"))
        code = run.wait(PATIENCE_S)
    finally:
        run.kill()
        run.wait()
    assert done.returncode == 0, done.stderr
    assert code in (1, 130)
    if code == 130:
        assert "switch each off and on" in (tmp_path / "said").read_text().splitlines()[-1]
    assert f"process {run.pid} (" in done.stderr
    assert done.stdout.startswith("sent 10 stops on ")
    _, record = emulator.end()
    assert at_rest(record)
    assert [e for e in record if e["event"] == "command"][-1]["flags"] & Flag.EMERGENCY_STOP
