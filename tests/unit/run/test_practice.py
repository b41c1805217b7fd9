"""Tests that `lab check` reports a slow or busy computer before robots move."""

import pytest
from testkit.running import QUICK

from tetractl.core.clock import MILLISECOND, SECOND, VirtualClock
from tetractl.lab.preflight import Preflight
from tetractl.run.practice import FACT, PRACTICE_S, Practice, practise
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
    findings = practice.added_to(GOOD, LIMITS)
    assert findings.can_start
    assert findings.warnings == ()
    assert findings.facts[FACT].startswith("median 100 ms, at most 100 ms, for a period of 200 ms")


def test_a_computer_that_plans_late_is_a_problem():
    """Regression: `lab check` called a computer ready on which every trial was aborted."""
    practice = practise(SPEC, HostClock(lambda: 3 * PERIOD_NS), silence)
    findings = practice.added_to(GOOD, LIMITS)
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
    findings = Practice(PERIOD_NS, delays_ns, 0).added_to(GOOD, LIMITS)
    assert bool(findings.problems) == (level == "problem")
    assert bool(findings.warnings) == (level == "warning")


@pytest.mark.parametrize("ms", [99, 101])
def test_a_camera_that_is_not_read_while_steps_are_planned_is_a_problem(ms):
    silences = iter([8 * MILLISECOND, ms * MILLISECOND])
    practice = practise(SPEC, HostClock(lambda: 0), lambda: next(silences, 8 * MILLISECOND))
    assert practice.silence_ns == ms * MILLISECOND
    findings = practice.added_to(GOOD, LIMITS)
    assert findings.can_start == (ms == 99)
    assert all("no frame was read for 101 ms" in problem for problem in findings.problems)


def test_a_signal_ends_the_practice():
    def pressed():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        practise(SPEC, HostClock(lambda: 0), pressed)


def test_the_median_and_the_longest_step_are_stated():
    delays_ns = tuple(ms * MILLISECOND for ms in (20, 170, 30, 40, 90))
    findings = Practice(PERIOD_NS, delays_ns, 0).added_to(GOOD, LIMITS)
    assert findings.facts[FACT].startswith(
        "median 40 ms, at most 170 ms, for a period of 200 ms, in 5 "
    )
    assert (findings.problems, findings.warnings) == ((), ())
    assert FACT not in Practice(PERIOD_NS, (), 0).added_to(GOOD, LIMITS).facts
