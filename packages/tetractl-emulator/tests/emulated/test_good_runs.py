"""Tests of runs without faults in an emulated lab, over real connections."""

import pytest
from testkit.emulator.good_runs import RUNS, check, script_of
from testkit.emulator.lab_processes import play
from testkit.emulator.scripts import load_script

pytestmark = pytest.mark.system


def test_two_trials_over_multicast(tmp_path):
    name = "multicast, two trials"
    _, sets, replace_after = RUNS[name]
    options = () if replace_after is None else ("--replace-after", str(replace_after))
    script = script_of(name, tmp_path)
    check(sets, play(script, load_script(script), tmp_path, *options, sets=sets))
