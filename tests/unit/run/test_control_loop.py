"""Tests of a trial with fake plant, controller and observers: order of calls, faults and ends."""

import threading
import time
from contextlib import nullcontext, suppress
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from testkit.fakes import bench
from testkit.hand_clock import HandClock

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.commands import Command, Stop, Turn
from tetractl.core.errors import AbortError, ControlError, LogError
from tetractl.core.plan import PAUSE_S, Outcome
from tetractl.core.poses import Observation, Poses, Sample
from tetractl.core.trial import Verdict
from tetractl.run.control_loop import (
    PAUSING_TEXT,
    TURNING_TEXT,
    FrameIntake,
    Halt,
    LoopEnd,
    RobotMotion,
    StepPacing,
    describe_motion_change,
    outcome_and_reason,
)

PERIOD = SECOND // 5
DECIDED = [Outcome.ARRIVED, Outcome.SEQUENCE_COMPLETED, Outcome.STEPS_MAX]


PATIENCE_S = 60
"""Before a test gives up on another thread; no test waits for it to pass."""


class BugError(Exception):
    """Stands for an error in the code, which is no TetractlError."""


def assert_ended_well(fakes, outcome):
    """Robots stopped before anything else, once; plant closed; every observer notified."""
    names = fakes.happenings.names
    assert names.count("stop") == names.count("settle") == names.count("close") == 1
    assert names.index("stop") < names.index("settle") < names.index("close")
    for observer in fakes.observers:
        assert len(observer.stops) == 1
        stop, result = observer.stops[0]
        assert stop.direction is None
        assert result.outcome is outcome
        assert names.index("close") < names.index(f"{observer.name}.stop")
    return fakes.observers[0].stops[0][1] if fakes.observers else None


def assert_stopped_next(names, where, nth):
    """The robots were stopped next after the n-th call of `where`."""
    calls = [i for i, name in enumerate(names) if name == where]
    assert names[calls[nth - 1] + 1] == "stop"


def twice(fakes):
    fakes.interrupt.request()
    fakes.interrupt.request()


def until(event):
    assert event.wait(PATIENCE_S), "another thread did not come so far"


# ---- The course of a trial ----


@pytest.mark.parametrize("outcome", DECIDED)
@pytest.mark.parametrize("steps", [0, 1, 3])
def test_the_controller_decides_when_a_trial_is_over(outcome, steps):
    fakes = bench(steps, outcome)
    result = fakes.run()
    assert result == assert_ended_well(fakes, outcome)
    assert (result.outcome, result.reason, result.steps) == (outcome, "", steps)
    assert result.duration_s == pytest.approx(steps * 0.2)
    assert len(result.solve_ns) == steps
    assert result.robot_errors == pytest.approx((10, 5, 0))
    assert result.total_error == pytest.approx(15)
    assert not result.entered_obstacle


def test_the_loop_observes_plans_steers_and_records_at_the_control_period():
    fakes = bench(2)
    fakes.run()
    step = ["observe", "plan", "send", "log.samples", "log.step"]
    assert fakes.happenings.names == [
        *("open", "log.start", *step, *step, "observe", "plan"),
        *("stop", "settle", "close", "log.samples", "log.stop"),
    ]
    assert fakes.plant.steered == [(0, 0.1), (PERIOD, 0.0)]
    assert [observation.sampled_ns for observation in fakes.controller.seen] == [
        0,
        PERIOD,
        2 * PERIOD,
    ]
    log = fakes.observers[0]
    assert [(step.k, step.command.sent_ns) for step in log.steps] == [(0, 0), (1, PERIOD)]
    assert [step.observation for step in log.steps] == fakes.controller.seen[:2]
    assert (log.start.plant.kind, log.start.plant.facts) == ("fake", {"bench": "left"})
    assert log.start.trial == 4


# ---- Faults ----

IN_A_STEP = [
    ("plan", 1),
    ("plan", 2),
    ("send", 1),
    ("observe", 2),
    ("log.start", 1),
    ("log.step", 1),
    ("log.samples", 2),
]
"""Calls during a trial, and which of them."""


FAULT = ControlError("no finite cost")
ERRORS = {"a fault": FAULT, "a bug": BugError("off by one")}
REASONS = {"a fault": "no finite cost", "a bug": "BugError: off by one"}


def run_to_its_end(fakes, kind):
    """The result of a trial that a fault ends; a bug is raised again, and leaves none."""
    raised = pytest.raises(BugError, match="off by one") if kind == "a bug" else nullcontext()
    with raised:
        return fakes.run()


@pytest.mark.parametrize("kind", ERRORS)
@pytest.mark.parametrize(("where", "nth"), IN_A_STEP)
def test_an_error_stops_the_robots_and_is_the_reason(where, nth, kind):
    fakes = bench(observers=("log", "view"))
    fakes.fail_at(where, nth, ERRORS[kind])
    run_to_its_end(fakes, kind)
    assert assert_ended_well(fakes, Outcome.ABORTED).reason == REASONS[kind]
    assert_stopped_next(fakes.happenings.names, where, nth)


@pytest.mark.parametrize("kind", ERRORS)
@pytest.mark.parametrize("second", ["stop", "settle", "log.stop"])
def test_of_two_errors_the_first_is_the_reason(kind, second):
    fakes = bench()
    fakes.fail_at("plan", 2, ERRORS[kind])
    fakes.fail_at(second, 1, type(ERRORS[kind])("the second"))
    run_to_its_end(fakes, kind)
    ((_, result),) = fakes.observers[0].stops
    assert (result.outcome, result.reason) == (Outcome.ABORTED, REASONS[kind])


@pytest.mark.parametrize("error", [AbortError("no robot answers"), BugError("typo")])
def test_a_plant_that_does_not_open_is_stopped_closed_and_nobody_is_told(error):
    fakes = bench()
    fakes.fail_at("open", 1, error)
    with pytest.raises(type(error)):
        fakes.run()
    assert fakes.happenings.names == ["open", "stop", "close"]


class MuteError(Exception):
    """Stands for an error without a text."""

    def __str__(self):
        raise ValueError("no text")


NOT_OURS = [SystemExit(0), GeneratorExit(), MuteError()]


@pytest.mark.parametrize("error", NOT_OURS)
def test_robots_stop_whatever_a_controller_raises(error):
    fakes = bench()
    fakes.fail_at("plan", 2, error)
    with pytest.raises(type(error)):
        fakes.run()
    result = assert_ended_well(fakes, Outcome.ABORTED)
    assert result.reason.startswith(type(error).__name__)


def test_a_plant_that_cannot_settle_is_closed_and_its_log_ends():
    fakes = bench()
    fakes.fail_at("settle", 1, BugError("lost"))
    with pytest.raises(BugError):
        fakes.run()
    names = fakes.happenings.names
    assert names[names.index("stop") :][:3] == ["stop", "settle", "close"]
    assert names[-1] == "log.stop"


@pytest.mark.parametrize(
    ("steps", "call", "nth", "steps_s"),
    [(2, "settle", 1, 0.4), (3, "send", 2, 0.2)],
    ids=["at the end", "in the second step"],
)
def test_a_plant_that_fails_has_its_last_frames_in_the_log(steps, call, nth, steps_s):
    """Regression: once it could not say what it had sent, the frames since the last step, of the
    robots' coming to rest, were in no log."""
    fakes = bench(steps)

    def fail_after_the_call():
        if fakes.happenings.names.count(call) == nth:
            raise AbortError("the radio is gone")
        return []

    fakes.plant.events = fail_after_the_call
    result = fakes.run()
    assert (result.outcome, result.reason) == (Outcome.ABORTED, "the radio is gone")
    frames = [sample.observation.frame for sample in fakes.observers[0].samples]
    assert frames == list(range(round(10 * (steps_s + 1)) + 1))  # ten a second: 1 s to settle


# ---- Interruptions ----


@pytest.mark.parametrize("where", ["plan", "send", "observe", "log.step"])
def test_a_first_interruption_finishes_the_step(where):
    fakes = bench(5)
    fakes.do_at(where, 2, fakes.interrupt.request)
    result = fakes.run()
    assert_ended_well(fakes, Outcome.INTERRUPTED)
    assert result.steps == 2  # the step in which it came was recorded, and no other was begun
    assert result.reason == "interrupted; the control step was finished first"
    assert fakes.happenings.names.count("plan") == 2


@pytest.mark.parametrize("where", ["plan", "send", "log.step"])
def test_a_second_interruption_breaks_off_what_may_be_broken_off(where):
    fakes = bench(5)
    fakes.do_at(where, 2, lambda: twice(fakes))
    result = fakes.run()
    assert_ended_well(fakes, Outcome.INTERRUPTED)
    planning = where == "plan"  # steering and recording are never torn
    assert result.steps == (1 if planning else 2)
    at_once = "a second interruption stopped the trial at once"
    finished = "interrupted; the control step was"
    assert result.reason.startswith(at_once if planning else finished)
    fakes.interrupt.request()  # raises nothing: no code is breakable any more


def test_interruptions_while_the_robots_stop_tear_nothing():
    fakes = bench(2)
    for where in ("stop", "settle", "log.stop"):
        fakes.do_at(where, 1, fakes.interrupt.request)
    assert fakes.run().outcome is Outcome.SEQUENCE_COMPLETED
    assert_ended_well(fakes, Outcome.SEQUENCE_COMPLETED)


# ---- Time ----


def test_a_plan_that_takes_longer_than_the_period_misses_its_deadline(monkeypatch):
    watch = HandClock()  # by which plans are timed
    monkeypatch.setattr(time, "perf_counter_ns", watch.now)
    fakes = bench(4)
    for nth, taken_ns in enumerate([9 * PERIOD, PERIOD, PERIOD + 1, 5], start=1):
        fakes.do_at("plan", nth, partial(watch.advance_ns, taken_ns))
    result = fakes.run()
    assert result.solve_ns == (9 * PERIOD, PERIOD, PERIOD + 1, 5)
    assert result.deadline_misses == 1  # the first plan has no deadline
    missed = [step.deadline_missed for step in fakes.observers[0].steps]
    assert missed == [False, False, True, False]


@pytest.mark.parametrize(("late_ns", "next_ns"), [(PERIOD - 1, 2 * PERIOD), (PERIOD, 3 * PERIOD)])
def test_the_step_after_one_that_is_late_by_a_period_has_a_full_period_again(late_ns, next_ns):
    """Step 1 is due after a PERIOD. If it ends less than that late, step 2 is due when it would be
    anyway; otherwise a whole PERIOD after the end of step 1."""
    fakes = bench(3)
    fakes.do_at("log.step", 2, lambda: fakes.plant.clock.sleep_until(PERIOD + late_ns))
    fakes.run()
    assert [sent_ns for sent_ns, _ in fakes.plant.steered] == [0, PERIOD, next_ns]


# ---- The first plan in real time ----


def test_frames_are_told_while_the_first_plan_of_a_lab_is_computed():
    """They are in the log then, should the program be killed before the first step."""
    fakes = bench(steps=1, simulated=False)
    reported = threading.Event()
    fakes.do_at("log.samples", 1, reported.set)
    plan = fakes.controller.plan

    def slow(*arguments):
        until(reported)
        return plan(*arguments)

    fakes.controller.plan = slow
    assert fakes.run().outcome is Outcome.SEQUENCE_COMPLETED
    names = fakes.happenings.names
    assert names.index("log.samples") < names.index("plan") < names.index("send")


def test_each_turn_on_the_spot_after_driving_is_reported():
    """Regression: after turn, drive, turn only the first turn was in the log."""
    fakes = bench(6)
    fakes.controller.instead = {1: Turn(0.5), 2: Turn(0.4), 4: Turn(0.3)}
    fakes.run()
    turns = [note for note in fakes.observers[0].notes if "turn on the spot" in note.text]
    sent = {step.k: step.command.sent_ns for step in fakes.observers[0].steps}
    assert [note.t_ns for note in turns] == [sent[1], sent[4]]


def test_a_first_interruption_between_two_steps_begins_no_other(monkeypatch):
    """Regression: one in the wait for the next step let it be planned and sent."""
    fakes = bench(5)
    sleep_until = fakes.plant.clock.sleep_until

    def interrupted_while_asleep(when_ns):
        sleep_until(when_ns)
        fakes.interrupt.request()

    monkeypatch.setattr(fakes.plant.clock, "sleep_until", interrupted_while_asleep)
    result = fakes.run()
    assert result.reason == "interrupted; the control step was finished first"
    assert result.steps == fakes.happenings.names.count("plan") == 1


@pytest.mark.parametrize("error", [AttributeError("no 'misc'"), ControlError("no finite cost")])
def test_what_a_library_makes_of_an_interruption_is_an_interruption_too(error):
    """Regression: torn in an import or a compilation, numba raises errors of other kinds."""
    fakes = bench(5)

    def torn():
        fakes.interrupt.request()
        with suppress(KeyboardInterrupt):
            fakes.interrupt.request()
        raise error

    fakes.do_at("plan", 2, torn)
    result = fakes.run()
    assert_ended_well(fakes, Outcome.INTERRUPTED)
    assert result.reason == "a second interruption stopped the trial at once"


@pytest.mark.parametrize(("where", "nth"), [("log.step", 2), ("stop", 1)])
def test_a_bug_after_a_second_interruption_that_a_controller_has_caught_is_raised(where, nth):
    """Regression: one in the loop was taken for what a library makes of an interruption."""
    fakes = bench(5)

    def catch():
        with suppress(KeyboardInterrupt):
            twice(fakes)

    fakes.do_at("plan", 2, catch)
    fakes.fail_at(where, nth, BugError("off by one"))
    with pytest.raises(BugError):
        fakes.run()
    ended = fakes.observers[0].stops[0][1]
    assert (ended.outcome, ended.reason) == (Outcome.ABORTED, "BugError: off by one")


def test_a_trial_lasts_from_its_first_direction():
    """Not from the moment the lab was opened: the first plan may take a while."""
    fakes = bench(2)
    fakes.do_at("plan", 1, lambda: fakes.plant.clock.sleep_until(20 * SECOND))
    assert fakes.run().duration_s == pytest.approx(0.4)
    assert fakes.plant.steered[0][0] == 20 * SECOND


def test_every_camera_frame_is_told_once_those_of_coming_to_rest_too():
    fakes = bench(4)
    fakes.run()
    frames = [sample.observation.frame for sample in fakes.observers[0].samples]
    assert frames == list(range(8 + 10 + 1))  # 0.8 s of steps, 1 s to settle


AT_THE_END = [("log.samples", 3), ("log.stop", 1)]


@pytest.mark.parametrize("kind", ERRORS)
@pytest.mark.parametrize(("where", "nth"), AT_THE_END)
def test_a_log_that_fails_at_the_end_keeps_nothing_from_the_view(where, nth, kind):
    """Log and view are notified of the end once, the view after the last frame."""
    fakes = bench(2, observers=("log", "view"))
    fakes.fail_at(where, nth, ERRORS[kind])
    result = run_to_its_end(fakes, kind)
    if result is not None:
        assert (result.outcome, result.reason) == (Outcome.ABORTED, REASONS[kind])
    log, view = fakes.observers
    assert len(log.stops) == len(view.stops) == 1
    assert view.samples[-1].observation.frame == 14


def test_a_plant_that_does_not_open_says_why_even_if_it_cannot_stop():
    fakes = bench()
    fakes.fail_at("open", 1, BugError("the reason"))
    fakes.fail_at("stop", 1, AssertionError("never opened"))
    with pytest.raises(BugError, match="the reason"):
        fakes.run()
    assert fakes.happenings.names == ["open", "stop", "close"]


def test_a_plant_that_fails_in_a_step_has_the_frames_before_it_in_the_log():
    """Regression: those taken in the step in which it could not say what it had sent were lost."""
    fakes = bench(3)

    def fail_in_the_second_step():
        if fakes.happenings.names.count("send") == 2:
            raise AbortError("the radio is gone")
        return []

    fakes.plant.events = fail_in_the_second_step
    assert fakes.run().reason == "the radio is gone"
    frames = [sample.observation.frame for sample in fakes.observers[0].samples]
    assert frames == list(range(2 + 10 + 1))  # ten a second: 0.2 s of steps, 1 s to settle


@pytest.mark.parametrize("slow", [PERIOD, 5 * PERIOD // 2])
def test_after_an_overrun_the_steps_keep_their_distance(slow):
    """A step that takes one period, or 2.5: it is late, and those after it come a period apart.

    Regression: after a period to the nanosecond two steps were sent at once.
    """
    fakes = bench(5)
    clock = fakes.plant.clock
    fakes.do_at("plan", 2, lambda: clock.sleep_until(clock.now() + slow))
    fakes.run()
    sent = [when for when, _ in fakes.plant.steered]
    gaps = [later - earlier for earlier, later in pairwise(sent)]
    assert gaps == [PERIOD + slow, *[PERIOD] * 3]


# ---- When steps are due ----


def paced():
    """A pacing that started at 3 s, and its clock."""
    clock = VirtualClock()
    clock.sleep_until(3 * SECOND)
    pacing = StepPacing(clock, PERIOD / SECOND)
    pacing.start()
    return pacing, clock


@pytest.mark.parametrize(
    ("late_ns", "next_ns"),
    [
        (0, PERIOD),
        (PERIOD - 1, PERIOD),  # it hurries to make up for it
        (PERIOD, 2 * PERIOD),  # it cannot any more
        (3 * PERIOD, 4 * PERIOD),
    ],
)
def test_a_step_that_is_late_by_a_period_shifts_all_later_ones(late_ns, next_ns):
    pacing, clock = paced()
    clock.sleep_until(3 * SECOND + late_ns)
    assert pacing.finish(0, pauses=False) == 3 * SECOND + next_ns
    shift_ns = next_ns - PERIOD
    clock.sleep_until(3 * SECOND + next_ns)
    assert pacing.finish(1, pauses=False) == 3 * SECOND + 2 * PERIOD + shift_ns


def test_a_pause_and_a_delay_shift_all_later_steps():
    pacing, _ = paced()
    pause_ns = round(PAUSE_S * SECOND)
    assert pacing.finish(0, pauses=True) == 3 * SECOND + PERIOD + pause_ns
    assert pacing.finish(1, pauses=False) == 3 * SECOND + 2 * PERIOD + pause_ns
    pacing.delay(7)
    assert pacing.finish(2, pauses=False) == 3 * SECOND + 3 * PERIOD + pause_ns + 7


def test_the_times_of_steps_do_not_drift_by_rounding():
    pacing = StepPacing(VirtualClock(), 1 / 3)
    pacing.start()
    assert pacing.finish(2_999_999, pauses=False) == 1_000_000 * SECOND


# ---- Which frames the controller gets ----


class Frames:
    """Stands for a plant that has frames."""

    def __init__(self):
        self.waiting = []

    def samples(self):
        samples, self.waiting = self.waiting, []
        return samples


def seen(*times):
    """Samples of one robot, exposed at these times [ns]."""
    poses = Poses.from_array(np.zeros((1, 3)))
    valid = np.ones(1, bool)
    return [Sample(Observation(t, t, t + 2, poses, valid), None) for t in times]


def test_frames_between_two_steps_go_to_the_controller_once_and_to_observers_once():
    plant = Frames()
    intake = FrameIntake(plant)
    plant.waiting = seen(10, 20, 30)
    intake.collect()
    plant.waiting = seen(40, 50)
    first, last = (sample.observation for sample in seen(10, 40))
    between = intake.take_between(first, last)
    assert [frame.sampled_ns for frame in between] == [20, 30]
    assert [s.observation.sampled_ns for s in intake.pop_unreported()] == [10, 20, 30, 40, 50]
    assert intake.pop_unreported() == []
    plant.waiting = seen(60, 70)
    (later,) = (sample.observation for sample in seen(70))
    between = intake.take_between(last, later)
    assert [frame.sampled_ns for frame in between] == [50, 60]  # 50 had come too late before
    assert intake.take_between(later, later) == []


# ---- What robots do, and how a trial has ended ----


@pytest.mark.parametrize("before", RobotMotion)
@pytest.mark.parametrize("now", [RobotMotion.DRIVE, RobotMotion.TURN, RobotMotion.STAND])
def test_a_turn_and_a_pause_are_told_when_they_begin_and_a_pause_after_a_turn_is_not(before, now):
    text = describe_motion_change(before, now)
    if now is RobotMotion.TURN and before is not RobotMotion.TURN:
        assert text == TURNING_TEXT
    elif now is RobotMotion.STAND and before in (RobotMotion.NOT_BEGUN, RobotMotion.DRIVE):
        assert text == PAUSING_TEXT
    else:
        assert text == ""


def ended_by(loop_error=None, halt_error=None, at_rest="", unrest="", dead="", fault=None):
    loop = LoopEnd(Outcome.ABORTED if loop_error else Outcome.ARRIVED, error=loop_error)
    verdict = replace(Verdict.unknown(1), not_at_rest=at_rest, unrest=unrest)
    halt = Halt(Command(Stop(), 0, (True,)), verdict, [], [], halt_error)
    return outcome_and_reason(loop, halt, fault, dead)


LOST, FULL = AbortError("green is lost"), LogError("the disk is full")


@pytest.mark.parametrize(
    ("how", "outcome", "reason"),
    [
        ({}, Outcome.ARRIVED, ""),
        ({"dead": "blue stands"}, Outcome.ARRIVED, "blue stands"),
        ({"loop_error": LOST}, Outcome.ABORTED, "green is lost"),
        ({"halt_error": FULL}, Outcome.ABORTED, "the disk is full"),
        ({"loop_error": LOST, "halt_error": FULL}, Outcome.ABORTED, "green is lost"),
        (
            {"loop_error": LOST, "unrest": "red drives"},
            Outcome.ABORTED,
            "green is lost; red drives",
        ),
        ({"unrest": "red drives"}, Outcome.ARRIVED, ""),
        ({"at_rest": "red rolls"}, Outcome.ABORTED, "red rolls"),
        ({"at_rest": "red rolls", "dead": "x"}, Outcome.ABORTED, "red rolls"),
        ({"at_rest": "red rolls", "loop_error": LOST}, Outcome.ABORTED, "green is lost"),
        ({"loop_error": ValueError("3")}, Outcome.ABORTED, "ValueError: 3"),
    ],
)
def test_the_first_error_says_how_a_trial_ended_and_then_what_did_not_stop(how, outcome, reason):
    assert ended_by(**how) == (outcome, reason)
