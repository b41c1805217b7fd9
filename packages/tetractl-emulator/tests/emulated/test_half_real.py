"""A lab of which camera, actuator, both or neither are real; the real ones are an emulator's, over
sockets and a pseudo-terminal."""

import json

import pytest
from support.cli import process
from support.lab_processes import SMALL, SPEC, Emulator, flags

from tetractl.log.read.reader import read_trial

pytestmark = pytest.mark.system
OTHER = {"camera": "actuator", "actuator": "camera"}


@pytest.mark.parametrize("real", ["neither", "camera", "actuator", "both"])
def test_each_mix_of_real_and_emulated_devices_runs_and_verifies(tmp_path, real):
    emulator = Emulator(tmp_path, SMALL)
    try:
        ready = emulator.wait_for("ready")
        sets = (
            *SMALL,
            f"lab.camera.command_port={ready['command_port']}",
            f"lab.actuator.port={ready['port']}",
        )
        half = (f"plant.real={real}",) if real in OTHER else ()
        plant = "lab" if real == "both" else "emulated"
        words = ("--plant", plant, "--yes", "--quiet", "--out", "logs", *flags((*sets, *half)))
        done = process(tmp_path, "run", SPEC, *words)
        assert done.returncode == 0, done.stderr
    finally:
        emulator.close()
    trial = read_trial(tmp_path / "logs" / "trial-000.mcap")
    facts = trial.start.plant.facts
    assert trial.result.outcome.value == "time limit" and len(trial.steps) > 5
    moved = abs(trial.mocap[-1, :, :2] - trial.mocap[0, :, :2]).sum(axis=1)
    assert (moved > 50).all(), "the robots that are seen have driven"
    events = [json.loads(line)["event"] for line in emulator.record.read_text().splitlines()]
    assert ("run" in events) == (real in ("actuator", "both"))
    assert ("client" in events) == (real in ("camera", "both"))
    if real in OTHER:
        assert (facts["real"], facts["emulated"]) == (real, OTHER[real])
    process(tmp_path, "verify", "logs").ok()
