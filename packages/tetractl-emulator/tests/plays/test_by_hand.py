"""`tetractl play --plant emulated`: robots of an emulated lab, steered by hand."""

import pytest
from support.cli import tetractl
from support.lab_processes import SPEC
from support.running import TETRACTL
from support.terminal import Terminal
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
    done = tetractl(tmp_path, *PLAY, "--script", "keys.txt")
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == "error: blue is about to enter an obstacle"
    log = read_trial(tmp_path / "out/you/trial-000.mcap")
    assert not log.result.entered_obstacle
    assert log.origin.value == "emulated lab"
    assert tetractl(tmp_path, "verify", "out").ok()
    assert not (tmp_path / "out/controller").exists()


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
