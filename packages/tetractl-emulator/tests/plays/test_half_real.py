"""Tests of labs in which camera, actuator, both or neither are real, in virtual time.

Here, the "real" devices belong to another emulated lab, over connections in memory.
"""

from unittest import mock

import pytest
from testkit.cli import tetractl
from testkit.emulator.half_real import check_mix, words_of
from testkit.emulator.lab_processes import SMALL
from testkit.emulator.lab_processes import SPEC as THREE
from testkit.emulator.virtual_lab import virtual_lab
from tetractl_emulator.virtual_plant import EmulatedPlantSection

pytestmark = pytest.mark.slow


@pytest.mark.long
@pytest.mark.parametrize("real", ["neither", "camera", "actuator", "both"])
def test_each_mix_of_real_and_emulated_devices_runs_and_verifies(tmp_path, real):
    with virtual_lab(tmp_path, *SMALL, spec=THREE, ahead_s=0.5) as lab:
        tetractl(tmp_path, *words_of(real, (*lab.settings, "controller.deadline=60"))).ok()
        events = lab.events()
    check_mix(tmp_path, real, events)
    tetractl(tmp_path, "verify", "logs").ok()


@pytest.mark.parametrize("answer", [(), ("--yes",)])
def test_a_real_actuator_is_not_calibrated_by_an_emulated_camera(tmp_path, answer):
    """Regression: it was asked whether the robots may move, and what followed was a traceback;
    under `python -O` the real robots were driven at the spec's speed, whatever --limit said."""
    words = ("lab", "calibrate", THREE, "--plant", "emulated", "--set", "plant.real=actuator")
    with mock.patch.object(EmulatedPlantSection, "rig") as rig:
        done = tetractl(tmp_path, *words, *answer)
    assert done.returncode == 2
    assert "error: plant.real=actuator makes the robots real" in done.stderr
    assert "hint: calibrate real robots with --plant lab" in done.stderr
    rig.assert_not_called()
    assert not list(tmp_path.iterdir())
