"""A lab of which camera, actuator, both or neither are real, in virtual time: the real ones are an
emulated lab's, on wires in memory. `emulated/test_half_real.py` has it on real wires."""

import pytest
from support.cli import tetractl
from support.half_real import check_mix, words_of
from support.lab_processes import SMALL
from support.lab_processes import SPEC as THREE
from support.virtual_lab import virtual_lab

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("real", ["neither", "camera", "actuator", "both"])
def test_each_mix_of_real_and_emulated_devices_runs_and_verifies(tmp_path, real):
    with virtual_lab(tmp_path, *SMALL, spec=THREE, ahead_s=0.5) as lab:
        tetractl(tmp_path, *words_of(real, (*lab.settings, "controller.deadline=60"))).ok()
        events = lab.events()
    check_mix(tmp_path, real, events)
    tetractl(tmp_path, "verify", "logs").ok()
