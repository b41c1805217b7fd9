"""Tests that `lab check` reports a slow or busy computer before robots move."""

from dataclasses import replace

import pytest
from testkit.random_trials import trial
from testkit.running import QUICK

from tetractl.core.clock import MILLISECOND, SECOND, VirtualClock
from tetractl.core.commands import Stop
from tetractl.lab.preflight import Preflight
from tetractl.run.interrupt import Interrupt
from tetractl.run.practice import FACT_NAME, PRACTICE_S, PacedSteps, Practice, practise
from tetractl.spec.lab_section import LabLimits
from tetractl.spec.load import parse_spec

SPEC = parse_spec(QUICK, "quick.yaml")
PERIOD_NS = round(SPEC.experiment.controller.period * SECOND)
GOOD = Preflight((), None, 120.0, (), (), {})
LIMITS = LabLimits()


class HostClock(VirtualClock):
    """A clock by which every plan takes the time that `plan_ns` returns."""

    def __init__(self, plan_ns):
        super().__init__()
        self._plan_ns = plan_ns

    def sleep_until(self, when):
        super().sleep_until(when)
        self._now += self._plan_ns()


def silence():
    return 8 * MILLISECOND


def test_a_computer_that_plans_in_time_is_ready():
    practice = practise(SPEC, HostClock(lambda: PERIOD_NS // 2), silence)
    assert set(practice.delays_ns) == {PERIOD_NS // 2}
    steps = PRACTICE_S * SECOND / PERIOD_NS
    assert steps / 2 <= len(practice.delays_ns) <= steps + 1
    findings = practice.add_to(GOOD, LIMITS)
    assert findings.can_start
    assert findings.warnings == ()
    assert findings.facts[FACT_NAME].startswith(
        "median 100 ms, at most 100 ms, for a period of 200 ms"
    )


def test_a_computer_that_plans_late_is_a_problem():
    """Regression: `lab check` called a computer ready on which every trial was aborted."""
    practice = practise(SPEC, HostClock(lambda: 3 * PERIOD_NS), silence)
    findings = practice.add_to(GOOD, LIMITS)
    (problem,) = findings.problems
    count = len(practice.delays_ns)
    assert problem == (
        f"this computer is too slow or too busy: {count} of {count} practised control steps took "
        "longer than the control period"
    )


@pytest.mark.parametrize(
    ("late", "level"), [(0, ""), (1, "warning"), (2, "warning"), (3, "problem")]
)
def test_few_late_steps_are_a_warning(late, level):
    delays_ns = (*[PERIOD_NS + 1] * late, *[PERIOD_NS] * (10 - late))
    findings = Practice(PERIOD_NS, delays_ns, 0).add_to(GOOD, LIMITS)
    assert bool(findings.problems) == (level == "problem")
    assert bool(findings.warnings) == (level == "warning")


@pytest.mark.parametrize("ms", [99, 101])
def test_a_camera_that_is_not_read_while_steps_are_planned_is_a_problem(ms):
    silences = iter([8 * MILLISECOND, ms * MILLISECOND])
    practice = practise(SPEC, HostClock(lambda: 0), lambda: next(silences, 8 * MILLISECOND))
    assert practice.longest_silence_ns == ms * MILLISECOND
    findings = practice.add_to(GOOD, LIMITS)
    assert findings.can_start == (ms == 99)
    assert all("no frame was read for 101 ms" in problem for problem in findings.problems)


def test_a_signal_ends_the_practice():
    def pressed():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        practise(SPEC, HostClock(lambda: 0), pressed)


def test_the_median_and_the_longest_step_are_stated():
    delays_ns = tuple(ms * MILLISECOND for ms in (20, 170, 30, 40, 90))
    findings = Practice(PERIOD_NS, delays_ns, 0).add_to(GOOD, LIMITS)
    assert findings.facts[FACT_NAME].startswith(
        "median 40 ms, at most 170 ms, for a period of 200 ms, in 5 "
    )
    assert (findings.problems, findings.warnings) == ((), ())
    assert FACT_NAME not in Practice(PERIOD_NS, (), 0).add_to(GOOD, LIMITS).facts


# ---- The steps one by one ----


class Steps:
    """Control steps given to the observer that paces them, on a clock that a test sets."""

    def __init__(self):
        self.clock = VirtualClock()
        self.interrupt = Interrupt()
        self.silent_ns = 0
        self.paced = PacedSteps(PERIOD_NS, self.clock, lambda: self.silent_ns, self.interrupt)
        (self._step,) = trial(steps=1).steps

    def give(self, k, planned_ns=0, instead=None):
        """A step that took a time to plan; returns the time at which it was due to end."""
        self.clock.sleep_until(self.clock.now() + planned_ns)
        plan = replace(self._step.plan, instead=instead)
        self.paced.on_step(replace(self._step, k=k, plan=plan))
        return self.clock.now()


def test_a_step_ends_a_period_after_it_was_due_and_not_after_it_was_planned():
    steps = Steps()
    assert steps.give(0) == PERIOD_NS
    assert steps.give(1, PERIOD_NS // 4) == 2 * PERIOD_NS
    assert steps.give(2, PERIOD_NS) == 3 * PERIOD_NS
    assert steps.paced.delays_ns == [PERIOD_NS // 4, PERIOD_NS]


def test_a_late_step_is_made_up_for_by_at_most_a_period():
    """In the lab a step that is later is planned at once, for the newest frame."""
    steps = Steps()
    steps.give(0)
    assert steps.give(1, 3 * PERIOD_NS) == 4 * PERIOD_NS  # due at 1, known at 4, due again at 4
    assert steps.give(2) == 5 * PERIOD_NS
    assert steps.paced.delays_ns == [3 * PERIOD_NS, 0]


def test_steps_before_which_robots_stood_have_no_delay():
    """The first plan of a trial, and one after a pause, may take as long as it needs."""
    steps = Steps()
    steps.give(0, 9 * PERIOD_NS)
    steps.give(1, PERIOD_NS // 2)
    steps.give(0, PERIOD_NS)  # of the next trial
    steps.give(1, PERIOD_NS // 4, instead=Stop())
    steps.give(2, PERIOD_NS)
    steps.give(3, PERIOD_NS // 8)
    assert steps.paced.delays_ns == [PERIOD_NS // 2, PERIOD_NS // 4, PERIOD_NS // 8]
    assert steps.paced.step_count == 6


def test_the_longest_silence_is_kept():
    steps = Steps()
    for k, silent_ns in enumerate((5, 90, 20)):
        steps.silent_ns = silent_ns
        steps.give(k)
    assert steps.paced.longest_silence_ns == 90


def test_the_practice_ends_before_a_step_that_would_end_too_late():
    steps = Steps()
    steps.clock.sleep_until(17 * SECOND)  # of before it
    for k in range(round(PRACTICE_S * SECOND) // PERIOD_NS):
        assert not steps.paced.is_over
        steps.give(k)
        assert not steps.interrupt.requested
    steps.give(99)
    assert steps.paced.is_over
    assert steps.interrupt.requested


@pytest.mark.parametrize(("ms", "starts"), [(100, True), (101, False)])
def test_a_silence_counts_from_the_time_after_which_robots_stop(ms, starts):
    assert LIMITS.stale == 0.1
    findings = Practice(PERIOD_NS, (), ms * MILLISECOND).add_to(GOOD, LIMITS)
    assert findings.can_start == starts


def test_earlier_findings_are_kept():
    before = replace(GOOD, problems=("no radio",), warnings=("old",), facts={"camera": "fake"})
    findings = Practice(PERIOD_NS, (1, 2), SECOND).add_to(before, LIMITS)
    assert findings.problems[0] == "no radio"
    assert len(findings.problems) == 2
    assert findings.warnings == ("old",)
    assert set(findings.facts) == {"camera", FACT_NAME}
    assert before.facts == {"camera": "fake"}
