"""Days of a fixed seed; what a night of new seeds finds becomes a script of faults."""

import pytest
from support.cli import tetractl
from support.lab_processes import SPEC

pytestmark = pytest.mark.system


def test_days_of_a_fixed_seed_break_nothing(tmp_path):
    words = ("--days", "100", "--seed", "2", "--jobs", "2", "--out", "days")
    done = tetractl(tmp_path, "lab", "rehearse", SPEC, *words)
    assert done.stdout.endswith("100 days, 0 violations\n"), done.stderr
