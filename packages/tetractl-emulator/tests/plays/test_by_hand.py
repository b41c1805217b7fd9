"""Tests of steering an emulated lab by hand with `tetractl play --plant emulated`."""

import re

import pytest
from testkit.cli import tetractl
from testkit.emulator.lab_processes import SPEC
from testkit.running import TETRACTL
from testkit.terminal import Terminal
from tetractl_emulator import firmware

from tetractl.log.read.reader import read_trial

pytestmark = [
    pytest.mark.slow,
    pytest.mark.long,
    pytest.mark.skipif(firmware.compiler() is None, reason="no C compiler found"),
]
PLAY = ("play", SPEC, "--plant", "emulated", "-o", "out")


def test_the_guard_stops_robots_that_are_steered_into_an_obstacle(tmp_path):
    (tmp_path / "keys.txt").write_text("0 right\n9 space\n")
    done = tetractl(tmp_path, *PLAY, "--script", "keys.txt").ok()
    lost = r"you stopped after [\d.]+ s \(blue is about to enter an obstacle\)"
    assert re.fullmatch(rf"{lost}, the controller [\d.]+ mm in \d+ s\n", done.stdout)
    assert "error" not in done.stderr
    assert "disturbances" not in done.stderr  # of a simulation
    log = read_trial(tmp_path / "out/you/trial-000.mcap")
    assert not log.result.entered_obstacle
    assert log.origin.value == "emulated lab"
    assert tetractl(tmp_path, "verify", "out").ok()


def test_a_try_that_the_guard_ends_is_lost_and_may_be_repeated(tmp_path):
    """Regression: the picture froze, and the program left with `error:`."""
    with Terminal([TETRACTL, *map(str, PLAY), "--speed", "10"], tmp_path) as terminal:
        terminal.expect("ESC: EMERGENCY STOP")
        terminal.press("\x1b[C")
        terminal.expect(r"You: stopped after [\d.]+ s")
        terminal.expect(r"is lost\. ")
        terminal.expect("ENTER: the controller  R: again")
        terminal.press("r")
        terminal.expect(r"→ \+0°|Press an arrow")
        terminal.press("\x1b[C")
        terminal.expect(r"is lost\. ")
        terminal.press("q")
        terminal.expect(r"you stopped after [\d.]+ s \(blue .*\), again stopped after")
        assert "error:" not in terminal.raw
        assert terminal.finish() == 0


def test_escape_is_the_emergency_stop(tmp_path):
    with Terminal([TETRACTL, *map(str, PLAY)], tmp_path) as terminal:
        terminal.expect("ESC: EMERGENCY STOP")
        terminal.press("\x1b[B")
        terminal.expect(r"↓ -90°")
        terminal.press("\x1b")
        terminal.expect("error: emergency stop by the operator")
        assert terminal.settings() == terminal.before
        assert terminal.finish() == 1
    assert tetractl(tmp_path, "verify", "out").ok()
