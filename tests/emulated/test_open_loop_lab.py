"""Robots of an emulated lab driven open loop: a design to identify them, and recorded commands."""

import json
import subprocess

import pytest
from support.lab_processes import PATIENCE_S, SMALL, SPEC, TETRACTL, Emulator, flags

from tetractl.log.read.reader import read_trial


@pytest.fixture
def settings(tmp_path):
    """Start an emulated lab; return the settings that lead to it."""
    emulator = Emulator(tmp_path, SMALL, "--replace-after", "0.2")
    try:
        ready = emulator.wait_for("ready")
        yield (
            *SMALL,
            f"lab.camera.command_port={ready['command_port']}",
            f"lab.camera.data_port={ready['data_port']}",
            f"lab.actuator.port={ready['port']}",
            "lab.limits.placing=30",
        )
    finally:
        emulator.close()


def tetractl(folder, *words):
    done = subprocess.run(
        [TETRACTL, *words],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=2 * PATIENCE_S,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_a_design_is_driven_and_its_commands_are_driven_again(tmp_path, settings):
    design = ("design", str(SPEC), "--seconds", "4", "--plant", "lab", "--yes")
    found = json.loads(tetractl(tmp_path, *design, "--logs", "design", "--json", *flags(settings)))
    assert found["origin"] == "emulated lab"
    log = read_trial(next((tmp_path / "design").glob("*.mcap")))
    assert log.result.outcome.complete
    assert log.result.verdict.entered == (False,) * 3
    for robot, a, speed in zip(found["robots"], (6, 4, 3), (180, 200, 150), strict=True):
        assert robot["a"]["value"] == pytest.approx(a, rel=0.3)
        assert robot["speed"]["value"] == pytest.approx(speed, rel=0.05)
    said = tetractl(tmp_path, "redrive", "design", "--plant", "lab", "--yes", "-o", "again")
    assert "open loop" in said
    again = read_trial(next((tmp_path / "again").glob("*.mcap")))
    assert again.origin.value == "emulated lab"
    assert [s.command.direction for s in again.steps] == [s.command.direction for s in log.steps]
