"""Shrinking: what does not matter goes, what matters stays."""

from tetractl_emulator.rehearsal.day import DayPlan
from tetractl_emulator.rehearsal.shrink import PLAYS_MAX, SHRINKS_S, shrunk

FAULTS = [
    {"fault": "jump", "robot": "green", "by": [300.0, 40.0], "at": 3.217},
    {"fault": "loss", "share": 0.5, "at": 1.0},
    {"fault": "late_radio", "by": 0.4, "at": 2.0, "for": 2.0},
]


def test_only_the_fault_that_matters_is_left_and_it_is_milder():
    plan = DayPlan(1, {"camera": {}, "robots": []}, FAULTS, "")

    def breaks(one):
        return any(f["fault"] == "late_radio" and f["by"] >= 0.1 for f in one.faults), 1.0

    small, plays = shrunk(plan, breaks)
    (fault,) = small.faults
    assert fault["fault"] == "late_radio"
    assert fault["by"] == 0.1
    assert not small.emulation
    assert plays <= PLAYS_MAX


def test_a_plan_that_needs_all_stays():
    plan = DayPlan(1, {}, FAULTS, "")
    assert shrunk(plan, lambda one: (False, 1.0))[0] == plan


def test_long_plays_end_the_shrinking():
    plan = DayPlan(1, {"camera": {}, "robots": []}, FAULTS, "")
    assert shrunk(plan, lambda one: (False, SHRINKS_S / 3))[1] == 3
