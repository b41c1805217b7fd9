import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit import problems
from testkit.paths import ROOT

from tetractl.control.search.optimizers.multistart import Multistart
from tetractl.core.obstacles import Obstacles
from tetractl.core.plan import Limits, Problem
from tetractl.core.poses import Poses
from tetractl.spec.load import load_spec

pytestmark = pytest.mark.slow

EXPERIMENT = ROOT / "experiments" / "three_m3pi.yaml"
NEAR = ["controller.collision.radius=20", "controller.collision.separation=0"]


def reference_problem():
    experiment = load_spec(EXPERIMENT, NEAR).experiment
    return experiment.controller.problem(experiment.setup)


def test_the_reference_problem_is_solved_from_any_seed():
    problem = reference_problem()
    spec = Multistart()
    searches = [spec.search(problem, 44, None, key, Limits()) for key in range(20)]
    assert [search.stopped for search in searches] == ["target"] * 20


@given(
    steps=st.sampled_from([1, 3000, 20_000]),
    seed=st.integers(0, 2**32),
    length=st.integers(2, 24),
    warmed=st.booleans(),
)
def test_looks_at_the_deadline_change_no_bit(steps, seed, length, warmed):
    """Regression: a look before the first iteration of a polish added an evaluation, so that
    `verify`, which looks, disagreed with a trial whose robots stood."""
    problem = problems.problem(problems.world(seed, 2, 1, "exact"))
    spec = Multistart(rounds=2)
    warm = np.random.default_rng(seed).uniform(-3, 3, length) if warmed else None
    result = spec.search(problem, length, warm, seed, Limits())
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("tetractl.control.search.kernels.multistart.ROBOT_STEPS_PER_CHECK", steps)
        looked = spec.search(problem, length, warm, seed, Limits(expired=lambda _: False))
    assert looked.history.tobytes() == result.history.tobytes()
    assert looked.signals.tobytes() == result.signals.tobytes()
    assert (looked.evaluations, looked.stopped) == (result.evaluations, result.stopped)


@given(
    tolerance=st.sampled_from([1e-3, 100.0, 1000.0]),
    looks=st.integers(0, 6),
    seed=st.integers(0, 2**32),
    warmed=st.booleans(),
)
def test_a_search_that_was_cut_short_comes_out_again(tolerance, looks, seed, warmed):
    """As `verify` repeats it: the deadline passes at the evaluations of the record. Regression: a
    search cut short at a sequence that was good enough said that it had reached its target."""
    spec = Multistart(rounds=2, tolerance=tolerance)
    problem = problems.problem(problems.world(seed, 2, 1, "exact"))
    warm = np.random.default_rng(seed).uniform(-3, 3, 20) if warmed else None
    answers = iter([False] * looks)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("tetractl.control.search.kernels.multistart.ROBOT_STEPS_PER_CHECK", 500)
        late = Limits(expired=lambda _: next(answers, True))
        result = spec.search(problem, 20, warm, seed, late)
        most = result.evaluations if result.stopped == "deadline" else math.inf
        again = spec.search(problem, 20, warm, seed, Limits(expired=lambda spent: spent >= most))
    assert again.history.tobytes() == result.history.tobytes()
    assert again.signals.tobytes() == result.signals.tobytes()
    assert (again.evaluations, again.stopped) == (result.evaluations, result.stopped)


def test_knots_and_iterations_grow_with_the_square_of_the_robots():
    two = problems.problem(problems.world(1, robots=2, obstacles=0, model="exact"))
    twelve = problems.problem(problems.world(1, robots=12, obstacles=0, model="exact"))
    assert Multistart().growth_factor(two) == 1  # as for any number up to three
    assert Multistart().growth_factor(twelve) == (12 / 3) ** 2
    assert Multistart(grows=False).growth_factor(twelve) == 1


def test_eight_robots_are_led_to_their_targets():
    """1 m in one direction, and each by another 0.2 m or so: 12 knots never do it."""
    rng = np.random.default_rng(1)
    starts = rng.uniform(0, 2000, (8, 2))
    problem = Problem(
        poses=Poses(*starts.T.copy(), np.zeros(8)),
        targets=starts + [1000, 0] + 200 * rng.standard_normal((8, 2)),
        a=np.linspace(2, 6, 8),
        speed=rng.uniform(150, 200, 8),
        motion="exact",
        period=0.2,
        first_period=0.2,
        obstacles=Obstacles.from_shapes(),
        obstacle_weight=1000.0,
        swept=False,
    )
    searches = [
        Multistart(grows=grows).search(problem, 120, None, 1, Limits()) for grows in (False, True)
    ]
    assert [search.cost <= 1 for search in searches] == [False, True]
