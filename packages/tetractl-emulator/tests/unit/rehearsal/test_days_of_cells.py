"""Tests that a rehearsal with cells is judged by its exit code and reason only."""

import pytest
from testkit.emulator.made_days import at
from testkit.paths import EXAMPLES
from tetractl_emulator.rehearsal.day import DayOutcome
from tetractl_emulator.rehearsal.day_plan import DayPlan
from tetractl_emulator.rehearsal.outcome_invariants import outcome_violations
from tetractl_emulator.rehearsal.truth import Truth

from tetractl.spec.load import load_spec

SETUP = load_spec(EXAMPLES / "tetrahymena_dish.yaml").experiment.setup
DARK = {"kind": "dark", "right": "not tracked", "fault": "light", "share": 0.1, "at": 1.0}
CELLS = [[1.0, 1.0, 0.0], [2.0, 1.0, 0.0], [1.0, 2.0, 0.0], [2.0, 2.0, 0.0]]


def exposure(seconds, moved_mm):
    cells = [[x + moved_mm, y, heading] for x, y, heading in CELLS]
    return at(seconds, "truth", frame=0, poses=cells, unseen_ms=[0.0] * 4, currents_a=[0.5, 0.0])


@pytest.mark.parametrize(
    ("said", "broken"),
    [
        ("error: trial 1: cell 1 is not tracked (0.70 s)\n", set()),
        ("error: trial 1: the moon is full\n", {"reason"}),
        ("Traceback (most recent call last):\n", {"exit code"}),
    ],
)
def test_cells_that_swim_after_the_stop_break_nothing_but_a_wrong_end_does(said, broken):
    reason = said.removeprefix("error: trial 1: ").strip()
    events = [
        at(0.5, "run"),
        at(1.0, "guard", state="run", reason=""),
        exposure(1.0, 0.0),
        at(2.0, "fault", phase="start", name="light", row=0),
        at(3.0, "guard", state="abort", reason=reason),
        exposure(3.0, 0.4),
        exposure(3.4, 0.6),
    ]
    day = DayOutcome(DayPlan(1, {}, [DARK]), events, 1, said, None, "", 1.0)
    limits = load_spec(EXAMPLES / "tetrahymena_dish.yaml").experiment.lab.limits
    truth = Truth(day, SETUP, limits, 0.25, can_stand_still=False)
    names = {violation.name for violation in outcome_violations(truth)}
    assert names - {"log"} == broken  # this day has no log
