"""The rows of the fault table in virtual time: every script that needs no process of its own."""

import pytest
from support.fault_checks import SCRIPTS, check
from support.lab_processes import camera_of
from support.virtual_play import play

from tetractl.emulate.script import load_script

PLAN_S = {"late_steps": 0.08}


def in_process(path):
    if camera_of(path) != "optitrack":
        return False
    runner = load_script(path).runner
    return not (runner.on_mark or runner.second or runner.file_limit)


@pytest.mark.parametrize("path", list(filter(in_process, SCRIPTS)), ids=lambda path: path.stem)
def test_fault(path, tmp_path):
    script = load_script(path)
    check(script, play(path, script, tmp_path, plan_s=PLAN_S.get(path.stem, 0.0)))
