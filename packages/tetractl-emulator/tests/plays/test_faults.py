"""The rows of the fault table in virtual time: every script that needs no process of its own."""

import pytest
from support.fault_checks import IN_PROCESS, check
from support.scripts import load_script
from support.virtual_lab import play

pytestmark = pytest.mark.slow

PLAN_S = {"late_steps": 0.08}


@pytest.mark.parametrize("path", IN_PROCESS, ids=lambda path: path.stem)
def test_fault(path, tmp_path):
    script = load_script(path)
    check(script, play(path, script, tmp_path, plan_s=PLAN_S.get(path.stem, 0.0)))
