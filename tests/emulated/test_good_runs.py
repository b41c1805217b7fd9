"""Runs in an emulated lab in which nothing goes wrong, on real wires of two kinds."""

import pytest
from support.good_runs import RUNS, check, script_of
from support.lab_processes import play

from tetractl.emulate.script import load_script


@pytest.mark.parametrize("name", ["multicast, two trials", "transparent radio, uneven robots"])
def test_a_run_in_which_nothing_goes_wrong(name, tmp_path):
    _, sets, replace_after = RUNS[name]
    options = () if replace_after is None else ("--replace-after", str(replace_after))
    script = script_of(name, tmp_path)
    check(sets, play(script, load_script(script), tmp_path, *options, sets=sets))
