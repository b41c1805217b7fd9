"""Tests of deadlines that simulations measure by the work of their searches."""

import itertools

import numpy as np
import pytest
from testkit.paths import ROOT

from tetractl.control.search.kernels.multistart import ROBOT_STEPS_PER_CHECK
from tetractl.control.search.work_clock import ROBOT_STEP_NS, SEARCH_NS, WorkClock
from tetractl.core.clock import SECOND
from tetractl.core.plan import Limits, Search, StopReason, never_expires
from tetractl.log.read.reader import read_trial
from tetractl.run.interrupt import Interrupt
from tetractl.run.logged_trial import log_path, run_logged
from tetractl.spec.load import load_spec, parse_spec


class Steady:
    """An optimiser that looks at the deadline after each of 10 evaluations."""

    def search(self, problem, length, warm, key, limits):
        spent = next((n for n in range(1, 10) if limits.expired(n)), 10)
        return Search(length, np.zeros(length), 0.0, np.zeros(1), spent, StopReason.ITERATIONS)


def test_searches_advance_the_clock_while_they_run_and_after_them():
    spec = load_spec(ROOT / "experiments" / "three_m3pi.yaml").experiment
    clock = WorkClock()
    problem = spec.controller.problem(spec.setup)
    search_ns = 3 * 20 * ROBOT_STEP_NS
    end = SEARCH_NS + 4 * search_ns
    timed = Limits(expired=lambda _: clock() >= end)
    search = clock.wrap(Steady()).search
    assert search(problem, 20, None, 1, timed).evaluations == 4
    assert clock() == end
    assert search(problem, 20, None, 1, Limits(expired=never_expires)).evaluations == 10
    assert clock() == end + SEARCH_NS + 10 * search_ns


FOUR_ROBOTS = """[
  {name: one, start: [900, 800], heading: 2.0, target: [1900, 1700], a: 6, speed: 180},
  {name: two, start: [2000, 600], heading: -1.0, target: [800, 1300], a: 4, speed: 200},
  {name: three, start: [800, 1900], heading: 0.5, target: [1700, 500], a: 3, speed: 150},
  {name: four, start: [2000, 1900], heading: 3.0, target: [1000, 600], a: 5, speed: 170}
]"""


@pytest.mark.long
def test_four_robots_are_planned_for_within_the_deadline(tmp_path):
    text = (ROOT / "experiments" / "three_m3pi.yaml").read_text()
    changes = [f"robots={FOUR_ROBOTS}", "controller.time_limit=20.2", "controller.deadline=0.0015"]
    spec = parse_spec(text, "four.yaml", changes)
    run_logged(spec, tmp_path, 0, (), Interrupt())
    steps = read_trial(log_path(tmp_path, 0)).steps
    moving = [now.plan for last, now in itertools.pairwise(steps) if not last.plan.pauses]

    def work_of_search_ns(search):
        robot_steps = 4 * search.length * search.evaluations
        return SEARCH_NS + robot_steps * ROBOT_STEP_NS

    work = [sum(map(work_of_search_ns, plan.searches)) for plan in moving]
    look = 2 * ROBOT_STEPS_PER_CHECK * ROBOT_STEP_NS + SEARCH_NS
    deadline_ns = spec.experiment.controller.deadline * SECOND
    assert max(work) <= deadline_ns + look
    ended = [search.stopped for plan in moving for search in plan.searches]
    assert StopReason.DEADLINE in ended


def test_a_deadline_is_the_default():
    ours = load_spec(ROOT / "experiments" / "three_m3pi.yaml").experiment.controller
    assert ours.deadline == pytest.approx(0.8 * ours.period)
