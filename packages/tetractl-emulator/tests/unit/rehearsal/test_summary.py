"""Tests of the summary of many rehearsed days."""

from types import SimpleNamespace

import pytest
from testkit.emulator.made_days import at, give_log
from testkit.trials import experiment
from tetractl_emulator.rehearsal.day import DayOutcome
from tetractl_emulator.rehearsal.day_plan import DayPlan
from tetractl_emulator.rehearsal.summary import (
    SUMMARY_FIELDS,
    describe_endings,
    fault_table,
    frequent_reasons,
    summarize_day,
)
from tetractl_emulator.rehearsal.truth import Truth, Violation

from tetractl.core.plan import Outcome
from tetractl.spec.lab_section import LabLimits

SETUP = experiment().setup
ROWS = [
    {"met": [["pushed", 0.2]], "ended": "aborted", "seconds": 1.0, "violations": []},
    {"met": [["pushed", 0.4]], "ended": "aborted", "seconds": 2.0, "violations": []},
    {"met": [["pushed", None]], "ended": "complete", "seconds": 2.0, "violations": []},
    {
        "met": [["pushed", 9.0], ["nan", 8.0]],
        "ended": "refused",
        "seconds": 3.0,
        "violations": [["enters", 1.0, "green"]],
    },
]


def test_times_are_of_days_with_one_fault():
    lines = fault_table(ROWS).splitlines()
    assert "| pushed | 4 | 3 | 2 | 0.300 | 0.398 | 0.400 |" in lines
    assert "| nan | 1 | 0 | 0 |  |  |  |" in lines
    assert len(lines) == 4


def test_shares_and_what_a_day_takes_are_said():
    assert describe_endings(ROWS) == (
        "2 aborted (50%); 1 complete (25%); 1 refused (25%); 2.00 s of processor time a day"
    )
    assert describe_endings([]) == "0.00 s of processor time a day"


def test_reasons_are_counted_whatever_their_numbers():
    texts = ("", "no frame for 0.51 s", "green is lost", "no frame for 2 s")
    rows = [{"reason": text} for text in texts]
    assert frequent_reasons(rows) == "2 days: no frame for … s\n1 day: green is lost"


STARTED = at(1.0, "run")


def row(events=(STARTED,), exit_code=0, outcome=None, output="", faults=(), found=(), seconds=2.0):
    """The row of a day with these events, and with a log if the trial has an outcome."""
    plan = DayPlan(1, {}, [{"right": "", "fault": fault["kind"], **fault} for fault in faults])
    outcome_of_day = DayOutcome(plan, list(events), exit_code, output, None, "", seconds)
    truth = Truth(outcome_of_day, SETUP, LabLimits(), 0.25)
    if outcome is not None:
        result = SimpleNamespace(outcome=outcome, reason="green is lost")
        give_log(truth, result=result)
    return summarize_day(3, truth, found, 0.25)


@pytest.mark.parametrize(
    ("day", "ended"),
    [
        ({"outcome": Outcome.ARRIVED}, "arrived"),
        ({"outcome": Outcome.ABORTED, "exit_code": 1}, "aborted"),
        ({"exit_code": 1}, "aborted"),  # the run began, but its log has no result
        ({"events": (), "exit_code": 1}, "refused"),
        ({"events": (), "exit_code": 0}, "refused"),
        ({"exit_code": -9}, "killed"),
        ({"events": (), "exit_code": -9}, "killed"),
        ({"outcome": Outcome.ABORTED, "exit_code": -9}, "killed"),
    ],
)
def test_a_day_ends_as_its_trial_or_is_refused_or_killed(day, ended):
    assert row(**day)["ended"] == ended


def test_a_row_has_each_field_and_the_time_of_the_run_and_of_its_checks():
    found = [Violation("outside", 1.23456, "green: 3 mm"), Violation("log", 0.0, "cut")]
    made = row(found=found, outcome=Outcome.ABORTED, exit_code=1)
    assert made.keys() == SUMMARY_FIELDS
    assert made["day"] == 3
    assert made["seconds"] == 2.25
    assert made["reason"] == "green is lost"
    assert made["violations"] == [["outside", 1.235, "green: 3 mm"], ["log", 0.0, "cut"]]
    assert row()["violations"] == row()["met"] == []


@pytest.mark.parametrize(
    ("guards", "noticed_s"),
    [
        ([], None),
        ([(1.5, "hold")], None),  # before the fault
        ([(2.0, "hold")], 0.0),
        ([(2.3, "abort")], 0.3),
        ([(2.2, "run"), (2.3, "ready"), (2.5, "hold"), (2.6, "abort")], 0.5),
        ([(1.5, "abort"), (2.25, "abort")], 0.25),
    ],
)
def test_a_fault_is_noticed_by_the_guards_next_hold_or_abort(guards, noticed_s):
    begins = at(2.0, "fault", phase="start", row=0)
    states = [at(at_s, "guard", state=state) for at_s, state in guards]
    fault = {"kind": "pushed", "at": 1.0}
    assert row([STARTED, begins, *states], faults=[fault])["met"] == [["pushed", noticed_s]]
