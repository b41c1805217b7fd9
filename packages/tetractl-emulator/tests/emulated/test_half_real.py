"""A lab of which camera, actuator or both are real: an emulator's, over sockets and a
pseudo-terminal."""

import json

import pytest
from support.cli import process
from support.half_real import check_mix, words_of
from support.lab_processes import SMALL, Emulator

pytestmark = [
    pytest.mark.system,
    pytest.mark.release,  # one of them in virtual time, in `plays`; both in test_good_runs.py
]


@pytest.mark.parametrize("real", ["both", "camera", "actuator"])
def test_each_mix_of_real_and_emulated_devices_runs_and_verifies(tmp_path, real):
    emulator = Emulator(tmp_path, SMALL)
    try:
        ready = emulator.wait_for("ready")
        camera = f"lab.camera.command_port={ready['command_port']}"
        sets = (*SMALL, camera, f"lab.actuator.port={ready['port']}")
        done = process(tmp_path, *words_of(real, sets))
        assert done.returncode == 0, done.stderr
    finally:
        emulator.close()
    events = [json.loads(line) for line in emulator.record.read_text().splitlines()]
    check_mix(tmp_path, real, events)
    process(tmp_path, "verify", "logs").ok()
