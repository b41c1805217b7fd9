"""Tests of deadlines that simulations measure by the work of their searches."""

import itertools

import numpy as np
import pytest
from testkit.paths import ROOT

from tetractl.control.search.kernels.multistart import BETWEEN_LOOKS
from tetractl.control.search.work_clock import ROBOT_STEP_NS, SEARCH_NS, WorkClock
from tetractl.core.clock import SECOND
from tetractl.core.plan import Limits, Search, StopReason, never
from tetractl.log.read.reader import read_trial
from tetractl.run.interrupt import Interrupt
from tetractl.run.spec_trial import log_path, run_logged
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
    assert search(problem, 20, None, 1, Limits(expired=never)).evaluations == 10
    assert clock() == end + SEARCH_NS + 10 * search_ns


@pytest.mark.long
def test_four_robots_from_anywhere_are_planned_for_within_the_deadline(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    from worlds import WORLDS

    text = WORLDS["anywhere"].spec(6200, 2).model_dump_json(exclude={"lab"})
    spec = parse_spec(
        text, "four.yaml", ["controller.time_limit=120.2", "controller.deadline=0.0015"]
    )
    run_logged(spec, tmp_path, 0, (), Interrupt())
    steps = read_trial(log_path(tmp_path, 0)).steps
    moving = [now.plan for last, now in itertools.pairwise(steps) if not last.plan.pauses]

    def work_of_search_ns(search):
        robot_steps = 4 * search.length * search.evaluations
        return SEARCH_NS + robot_steps * ROBOT_STEP_NS

    work = [sum(map(work_of_search_ns, plan.searches)) for plan in moving]
    look = 2 * BETWEEN_LOOKS * ROBOT_STEP_NS + SEARCH_NS
    deadline_ns = spec.experiment.controller.deadline * SECOND
    assert max(work) <= deadline_ns + look
    ended = [search.stopped for plan in moving for search in plan.searches]
    assert StopReason.DEADLINE in ended


def test_a_deadline_is_the_default():
    ours = load_spec(ROOT / "experiments" / "three_m3pi.yaml").experiment.controller
    assert ours.deadline == pytest.approx(0.8 * ours.period)
