"""Tests of the invariants about the log, the exit code and the reason, with made-up days."""

from types import SimpleNamespace

import numpy as np
import pytest
from testkit.emulator.made_days import at, give_log
from testkit.trials import experiment
from tetractl_emulator.rehearsal import outcome_invariants
from tetractl_emulator.rehearsal.day import HUNG, DayOutcome
from tetractl_emulator.rehearsal.day_plan import DayPlan
from tetractl_emulator.rehearsal.outcome_invariants import (
    exit_code_is_right,
    log_is_whole,
    outcome_violations,
    reason_names_a_fault,
)
from tetractl_emulator.rehearsal.truth import TRANSIT_S, Truth

from tetractl.core.commands import Steer, Stop, Turn
from tetractl.core.plan import Outcome
from tetractl.spec.lab_section import LabLimits

SETUP = experiment().setup
RUN = (at(1.0, "run"), at(1.0, "guard", state="run"))
END_S = 5.0
ALIVE_S = END_S - 1.0  # the emulation goes on for a second after our process
LOST = {"kind": "untracked", "right": "not tracked", "fault": "untracked", "robot": "green"}
KILL = {"kind": "killed", "right": "$.", "fault": "signal", "signal": "KILL"}
FULL = {"kind": "disk full", "right": "disk", "fault": "disk_full"}
TERM = {"kind": "signal", "right": "$.", "fault": "signal", "signal": "TERM"}
PRESS = {"kind": "stop", "right": "operator", "fault": "emergency"}
CREEPS = {"kind": "ghost", "right": "jumped", "fault": "ghost", "by": [9, 0], "turn": 0.0}
COMPLETE = {"outcome": Outcome.ARRIVED}
ABORTED = {"outcome": Outcome.ABORTED, "reason": "green is not tracked (0.3 s)"}


def exposure(at_s, unseen_ms=(5.0, 5.0, 5.0)):
    return at(at_s, "truth", frame=1, poses=[[0.0, 0.0, 0.0]] * 3, unseen_ms=list(unseen_ms))


def day(
    *events, fault=None, begins_s=2.0, code=1, output="", left="", result=None, met=True, **log
):
    """A day with a run from 1 s on, a fault, and a log if there is a result or a field of it."""
    plan = DayPlan(1, {}, [{**fault, "at": 0.0}] if fault else [])
    starts = [at(begins_s, "fault", phase="start", name=fault["fault"], row=0)] if fault else []
    events = [*events, *(starts if met else []), exposure(END_S)]
    in_order = sorted(events, key=lambda event: event["t_ns"])
    truth = Truth(
        DayOutcome(plan, in_order, code, output, None, left, 1.0), SETUP, LabLimits(), 0.25
    )
    if result is not None or log:
        made = None if result is None else SimpleNamespace(**{"reason": ""} | result)
        give_log(truth, **{"result": made, "steps": (), "stop": "stop"} | log)
    return truth


@pytest.fixture(autouse=True)
def agreeing(monkeypatch):
    """Let every log agree with itself, unless a test says otherwise."""
    differences = []
    monkeypatch.setattr(outcome_invariants, "result_differences", lambda *_: iter(differences))
    return differences


def findings(invariant, truth):
    return [violation.finding for violation in invariant(truth)]


def test_a_whole_log_of_a_run_and_no_log_without_a_run_are_right():
    assert findings(log_is_whole, day(*RUN, result=ABORTED)) == []
    assert findings(log_is_whole, day()) == []


def test_a_run_without_a_log_and_a_log_that_cannot_be_read_are_wrong():
    assert findings(log_is_whole, day(*RUN)) == ["none was written"]
    for events in ((), RUN):
        truth = day(*events)
        vars(truth)["log"] = "LogError: cut"
        assert findings(log_is_whole, truth) == ["LogError: cut"]


@pytest.mark.parametrize("log", [{"result": None}, {"damage": "cut"}])
@pytest.mark.parametrize(
    ("fault", "met", "wrong"),
    [
        (None, True, True),
        (LOST, True, True),
        (KILL, True, False),
        (FULL, True, False),
        (FULL, False, True),
    ],
)
def test_a_log_may_be_damaged_only_by_a_kill_or_a_full_disk(log, fault, met, wrong):
    given = ABORTED if "damage" in log else None
    made = {key: value for key, value in log.items() if key != "result"} or {"damage": None}
    truth = day(*RUN, fault=fault, met=met, result=given, **made)
    assert bool(findings(log_is_whole, truth)) == wrong


def test_a_log_needs_a_stop_and_must_not_contradict_itself(agreeing):
    assert findings(log_is_whole, day(*RUN, result=ABORTED, stop=None)) == ["has no stop"]
    agreeing += ["first", "second"]
    assert findings(log_is_whole, day(*RUN, result=ABORTED)) == ["first"]


def test_of_a_run_that_hangs_only_that_it_hangs_is_said():
    hangs = day(*RUN, code=HUNG, left="a thread")
    assert findings(log_is_whole, hangs) == []
    assert findings(exit_code_is_right, hangs) == ["hangs"]


@pytest.mark.parametrize(
    ("result", "code", "fault", "wrong"),
    [
        (COMPLETE, 0, None, False),
        (COMPLETE, 1, None, True),
        (ABORTED, 1, LOST, False),
        (ABORTED, 0, LOST, True),
        ({"outcome": Outcome.INTERRUPTED}, 130, TERM, False),
        ({"outcome": Outcome.INTERRUPTED}, 1, TERM, True),
        (None, 1, LOST, False),
        (None, 0, LOST, True),
        (None, -9, KILL, False),
        (None, 1, KILL, False),  # it ended before the kill
        (None, -9, LOST, True),
        (None, 0, KILL, True),
        (None, 130, TERM, True),
    ],
)
def test_a_run_ends_with_the_code_of_its_result(result, code, fault, wrong):
    truth = day(*RUN, fault=fault, code=code, result=result)
    assert bool(findings(exit_code_is_right, truth)) == wrong


@pytest.mark.parametrize(("fault", "wrong"), [(TERM, False), (LOST, True)])
def test_a_signal_may_end_a_process_that_still_waits_for_robots(fault, wrong):
    assert bool(findings(exit_code_is_right, day(fault=fault, code=130))) == wrong
    assert not findings(exit_code_is_right, day(fault=fault, code=1))


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("error: trial 1: KeyError: 'x'\n", True),
        ("Traceback (most recent call last):\n", True),
        ("stopped by KeyboardInterrupt\n", True),
        ("raised a StopException\n", True),
        ("error: trial 1: green is not tracked (0.30 s)\n", False),
        ("error: the port has an input/output error\n", False),
    ],
)
def test_an_error_of_our_program_is_wrong_in_what_is_printed_and_in_the_reason(text, wrong):
    assert bool(findings(exit_code_is_right, day(*RUN, output=text))) == wrong
    reason = ABORTED | {"reason": text}
    assert bool(findings(exit_code_is_right, day(*RUN, result=reason))) == wrong


def test_what_a_run_leaves_behind_is_named():
    assert findings(exit_code_is_right, day(*RUN, left="a thread")) == ["left behind: a thread"]


def counts(*events, **more):
    """What is wrong with a complete trial that ended at 2 s, after these events."""
    guard = at(2.0, "guard", state="ready")
    truth = day(*RUN, guard, *events, code=0, result=COMPLETE, **more)
    return findings(exit_code_is_right, truth)


@pytest.mark.parametrize(
    ("at_s", "wrong"),
    [
        (0.9, False),  # before the run
        (1.5, True),
        (ALIVE_S - TRANSIT_S - 0.01, True),
        (ALIVE_S - TRANSIT_S + 0.01, False),  # too late to be acted on
    ],
)
def test_no_trial_counts_after_an_emergency_stop(at_s, wrong):
    said = counts(fault=PRESS, begins_s=at_s)
    assert said == (["a trial counts although the emergency stop was pressed"] if wrong else [])


@pytest.mark.parametrize("robot", range(3))
def test_no_trial_counts_if_a_robot_was_unseen_at_the_end(robot):
    limit_ms = 1000 * LabLimits().stream_lost
    for unseen_ms, at_s, wrong in (
        (limit_ms - 1, ALIVE_S, False),
        (limit_ms + 1, ALIVE_S, True),
        (limit_ms + 1, ALIVE_S + 0.1, False),  # our process has ended
    ):
        row = [5.0, 5.0, 5.0]
        row[robot] = unseen_ms
        assert bool(counts(exposure(at_s, row))) == wrong
    earlier = [exposure(3.0, (limit_ms + 1, 5.0, 5.0)), exposure(3.5)]
    assert counts(*earlier) == []


@pytest.mark.parametrize(
    ("begins_s", "ends_s", "wrong"),
    [
        (1.5, None, True),
        (1.5, ALIVE_S + 0.1, True),
        (1.5, ALIVE_S - 0.1, False),
        (2.0 + TRANSIT_S - 0.01, None, True),
        (2.0 + TRANSIT_S + 0.01, None, False),  # the trial had ended
    ],
)
def test_no_trial_counts_if_the_camera_shows_motion_to_the_end(begins_s, ends_s, wrong):
    ends = [] if ends_s is None else [at(ends_s, "fault", phase="end", row=0)]
    assert bool(counts(*ends, fault=CREEPS, begins_s=begins_s)) == wrong


PERIOD_S = SETUP.period_s


def steps(*lengths, actions=()):
    """Control steps, each at once after the one before, which take so many periods."""
    made = []
    now_s = 0.0
    for k, length in enumerate(lengths):
        received_ns = round(now_s * 1e9)
        now_s += length * PERIOD_S
        action = dict(actions).get(k, Steer(0.0))
        made.append(
            SimpleNamespace(
                observation=SimpleNamespace(received_ns=received_ns),
                command=SimpleNamespace(sent_ns=round(now_s * 1e9), action=action),
            )
        )
    return made


def late(*lengths, actions=()):
    made = steps(*lengths, actions=actions)
    return any("were late" in said for said in counts(steps=made))


def test_more_late_steps_in_a_row_than_the_limit_must_end_a_trial():
    most = LabLimits().late_steps
    assert not late(0.5, *[1.01] * most)
    assert late(0.5, *[1.01] * (most + 1))
    assert not late(0.5, *[0.99] * (3 * most))
    assert not late(0.5, *[1.01] * most, 0.5, *[1.01] * most)
    assert late(0.5, *[1.01] * (most + 1), 0.5)  # not only at the end


@pytest.mark.parametrize("action", [Stop(), Turn(0.5)])
def test_a_step_that_stops_or_turns_and_the_next_are_not_late(action):
    most = LabLimits().late_steps
    row = [0.5, *[1.01] * most, 1.01, 1.01, *[1.01] * most]
    assert not late(*row, actions=[(most + 1, action)])
    assert late(*row, 1.01, actions=[(most + 1, action)])


def test_the_first_step_is_not_late_because_robots_stand():
    most = LabLimits().late_steps
    assert not late(*[1.01] * (most + 1))
    assert late(*[1.01] * (most + 2))


def test_a_frame_that_came_while_a_step_was_computed_waits_from_its_end():
    most = LabLimits().late_steps
    made = steps(0.5, *[1.01] * (most + 1))
    for step in made:
        step.observation.received_ns = 0
    assert any("were late" in said for said in counts(steps=made))


@pytest.mark.parametrize(
    ("reason", "fault", "met", "wrong"),
    [
        ("", None, True, False),
        ("green is not tracked", LOST, True, False),
        ("Green is NOT TRACKED", LOST, True, False),
        ("the moon is full", LOST, True, True),
        ("green is not tracked", LOST, False, True),  # the fault never became visible
        ("green is not tracked", None, True, True),
        ("green is outside the arena", None, True, True),
    ],
)
def test_a_reason_names_a_fault_that_was_there(reason, fault, met, wrong):
    truth = day(*RUN, fault=fault, met=met, result=ABORTED | {"reason": reason})
    assert findings(reason_names_a_fault, truth) == ([reason] if wrong else [])


def test_a_false_reason_is_dated_by_the_abort_or_by_a_great_number():
    aborts = at(3.0, "guard", state="abort", reason="x")
    (aborted,) = reason_names_a_fault(day(*RUN, aborts, result=ABORTED))
    (refused,) = reason_names_a_fault(day(output="error: the moon is full\n"))
    assert aborted.at_s == 3.0
    assert np.isfinite(refused.at_s) and refused.at_s > 1e5
    long = day(*RUN, result=ABORTED | {"reason": "x" * 900})
    assert findings(reason_names_a_fault, long) == ["x" * 200]


def test_cells_are_checked_by_all_three():
    truth = day(*RUN, code=0, result=ABORTED | {"reason": "the moon"}, stop=None)
    assert {violation.name for violation in outcome_violations(truth)} == {
        "log",
        "exit code",
        "reason",
    }
    assert outcome_violations(day(*RUN, fault=LOST, result=ABORTED)) == []
