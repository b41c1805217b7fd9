"""Shrinking: what does not matter goes, what matters stays."""

from tetractl_emulator import lab_rehearse
from tetractl_emulator.rehearsal.day import DayPlan
from tetractl_emulator.rehearsal.shrink import PLAYS_MAX, SHRINKS_S, shrunk

PLAY_S = 1.0  # how long a play takes; a play returns this and whether the plan breaks a sentence
FAULTS = [
    {"fault": "jump", "robot": "green", "by": [300.0, 40.0], "at": 3.217},
    {"fault": "loss", "share": 0.5, "at": 1.0},
    {"fault": "late_radio", "by": 0.4, "at": 2.0, "for": 2.0},
]


def test_only_the_fault_that_matters_is_left():
    plan = DayPlan(1, {"camera": {}, "robots": []}, FAULTS, ("controller.time_limit=3",))

    def breaks_by_a_late_radio(plan):
        late = [fault for fault in plan.faults if fault["fault"] == "late_radio"]
        return any(fault["by"] >= 0.1 for fault in late), PLAY_S

    small, plays = shrunk(plan, breaks_by_a_late_radio)
    assert small.faults == [FAULTS[2]]
    assert not small.emulation
    assert not small.settings
    assert plays <= PLAYS_MAX


def test_a_plan_that_needs_all_stays():
    plan = DayPlan(1, {}, FAULTS)
    small, _ = shrunk(plan, lambda plan: (False, PLAY_S))
    assert small == plan


def test_long_plays_end_the_shrinking():
    plan = DayPlan(1, {"camera": {}, "robots": []}, FAULTS)
    _, plays = shrunk(plan, lambda plan: (False, SHRINKS_S / 3))
    assert plays == 3


def test_a_day_that_hangs_is_not_played_again(tmp_path, monkeypatch):
    """Regression: it was, up to 40 times for 10 minutes each, as no sentence is named hangs."""

    def played(plan):
        raise AssertionError("the day is played")

    late = {"kind": "radio late", "strength": 0.5, **FAULTS[2]}
    plan = DayPlan(1, {}, [late])
    monkeypatch.setattr(lab_rehearse, "_day_of", lambda *_: (plan, played))
    violations = [["log", 0.0, "lacks a command"], ["exit code", 0.0, "hangs"]]
    row = {"day": 3, "violations": violations}
    script = tmp_path / "day.yaml"
    assert lab_rehearse.shrunk_day(tmp_path, (), 1, script, row)["plays"] == 0
    assert "late_radio" in script.read_text()
