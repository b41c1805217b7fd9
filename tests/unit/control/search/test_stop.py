import math

import numpy as np
from testkit.paths import ROOT

from tetractl.control.search.stop import (
    BudgetStop,
    RelativeStop,
    TargetStop,
    meets_paper_criterion,
    reason_to_stop,
)
from tetractl.core.plan import Plan, StopReason
from tetractl.core.poses import Observation
from tetractl.run.checked_controller import build_controller
from tetractl.spec.load import load_spec


def falling(first, *decreases):
    return first - np.cumsum([0.0, *decreases])


def test_20_by_hand():
    """J falls by 2 an iteration from 30, so Delta = 10 log 2 and C = sum(log J over 11) / 2."""
    history = falling(30, *[2.0] * 11)  # z = 11
    c = sum(math.log(n) for n in range(28, 7, -2)) / 2
    assert 10 * math.log(2) < c
    assert meets_paper_criterion(history)


def test_20_looks_back_ten_iterations_only():
    history = np.concatenate([[5000.0, 5000.0], 5000.0 - np.cumsum([400.0] * 10)])
    assert len(history) == 12  # z = 11: the standstill at z = 1 is outside Delta
    assert not meets_paper_criterion(history)


def test_a_cost_of_zero_is_minus_infinity_on_both_sides_and_no_stop():
    history = np.concatenate([falling(100, *[5.0] * 9), [0.0, 0.0]])
    assert history[-2:].tolist() == [0, 0]
    assert not meets_paper_criterion(history)


def test_20_as_printed_is_a_budget_of_11_iterations_in_the_reference_experiment():
    """Figure 3 of the paper stops at step 20: the formula as printed cannot have made it."""
    spec = load_spec(ROOT / "experiments" / "three_m3pi_paper.yaml").experiment
    tracked = np.ones(3, dtype=bool)
    plan = build_controller(spec, 1).plan(Observation(0, 0, 0, spec.setup.starts, tracked))
    assert isinstance(plan, Plan)
    assert len(plan.searches) == 51
    for search in plan.searches:
        assert len(search.history) == 1 + 11  # the swarm as it is drawn, and its iterations
        assert search.stopped is StopReason.CRITERION


def test_20_depends_on_the_unit_of_length():
    history = 5 + 100 * 0.75 ** np.arange(13)
    assert meets_paper_criterion(1000 * history) != meets_paper_criterion(history / 1000)


def test_the_relative_stop_looks_over_its_window():
    stop = RelativeStop(type="relative")
    flat = np.full(40, 100.0)
    assert reason_to_stop(flat[:11], stop) is None  # z = 10: the window is only just full
    assert reason_to_stop(flat[:12], stop) == "criterion"
    falling_enough = np.linspace(100, 50, 40)
    assert reason_to_stop(falling_enough, stop) is None
    assert reason_to_stop(falling_enough / 1e6, stop) is None  # unit-free
    just = np.array([100.0] * 5 + [99.0] * 10)
    assert reason_to_stop(just, stop) == "criterion"  # fell by the hundredth, not by more


def test_the_other_stops():
    target = TargetStop(type="target", cost=3.0)
    assert reason_to_stop(np.array([9.0, 3.1]), target) is None
    assert reason_to_stop(np.array([9.0, 3.0]), target) == "target"
    assert reason_to_stop(np.full(500, 1.0), BudgetStop(type="budget")) is None
