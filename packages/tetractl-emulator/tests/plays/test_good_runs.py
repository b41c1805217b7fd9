"""Runs in an emulated lab in which nothing goes wrong, over every kind of wire, in virtual time."""

import pytest
from support.good_runs import RUNS, check, script_of
from support.scripts import load_script
from support.virtual_lab import play

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", RUNS)
def test_a_run_in_which_nothing_goes_wrong(name, tmp_path):
    _, sets, replace_after = RUNS[name]
    script = script_of(name, tmp_path)
    played = play(script, load_script(script), tmp_path, replace_after=replace_after, sets=sets)
    check(sets, played)
