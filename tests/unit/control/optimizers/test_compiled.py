import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from support import problems

from tetractl.control.cost import evaluate
from tetractl.control.kernels.rollout import costs, lay_out
from tetractl.control.optimizers.pso import Pso
from tetractl.core.plan import Limits

MODELS = st.sampled_from(["euler", "arc", "exact"])


def compiled_costs(problem, signals):
    total = np.empty(len(signals))
    course = lay_out(problem, len(signals))
    for _ in range(2):  # the room a course works in is used again
        finite = costs(course, np.ascontiguousarray(signals.T), total)
    assert finite
    return total


@given(
    seed=st.integers(0, 2**32),
    robots=st.integers(1, 5),
    obstacles=st.integers(0, 4),
    length=st.integers(1, 60),
    particles=st.integers(1, 70),
    model=MODELS,
    swept=st.booleans(),
    first=st.floats(0.01, 0.2),
    apart=st.sampled_from([0.0, 50.0, 400.0]),
)
@example(167, 1, 0, 60, 34, "exact", False, 0.2, 0.0)  # headings near -u again and again
@example(0, 1, 1, 47, 15, "euler", False, 0.11354210870059285, 0.0)
def test_costs_agree(seed, robots, obstacles, length, particles, model, swept, first, apart):
    world = problems.world(seed, robots, obstacles, model, swept)
    problem = replace(problems.problem(world, apart), first_period=first)
    signals = np.random.default_rng(seed).uniform(-math.pi, math.pi, (particles, length))
    reference = evaluate(problem, signals).total
    allowed = 1e-9 * reference + spread(problem, signals, reference)
    assert np.all(np.abs(compiled_costs(problem, signals) - reference) <= allowed)


def spread(problem, signals, reference):
    """Return how far costs (P,) move when each signal moves by 1e-12 rad.

    A heading near -u doubles what it is off within a few signals, and rounding with it.
    """
    rng = np.random.default_rng(0)
    moved = [signals + rng.choice([-1e-12, 1e-12], signals.shape) for _ in range(4)]
    return np.max([np.abs(evaluate(problem, m).total - reference) for m in moved], axis=0)


@pytest.mark.parametrize("model", ["euler", "arc", "exact"])
@pytest.mark.parametrize("turn", [1e-6, 1e-3, 1.25, 3.0, 5.0, 20.0, 50.0])
def test_costs_agree_whatever_a_robot_turns_in_a_period(model, turn):
    """Regression: above a T of about 4 the sines of `euler` and `arc` left their range."""
    problem = problems.problem(problems.world(1, obstacles=0, model=model))
    problem = replace(problem, a=np.full(3, turn / problem.period))
    signals = np.random.default_rng(1).uniform(-math.pi, math.pi, (33, 3))
    reference = evaluate(problem, signals).total
    assert compiled_costs(problem, signals) == pytest.approx(reference, rel=1e-8)


@pytest.mark.parametrize("model", ["euler", "arc", "exact"])
def test_costs_agree_at_the_bounds_and_along_the_axes(model):
    """Directions of exactly 0, +-pi/2 and +-pi, where a sine or a turn vanishes."""
    problem = problems.problem(problems.world(2, obstacles=4, model=model))
    axes = np.array([0.0, math.pi / 2, -math.pi / 2, math.pi, -math.pi])
    signals = np.random.default_rng(2).choice(axes, (64, 9))
    assert compiled_costs(problem, signals) == pytest.approx(
        evaluate(problem, signals).total, rel=1e-9
    )


def test_a_search_leaves_its_problem_alone():
    problem = problems.problem(problems.world(3))
    before = [a.copy() for a in (problem.poses.array(), problem.targets, problem.a, problem.speed)]
    spec = Pso(particles=8, iterations=4)
    spec.search(problem, 5, None, 1, Limits())
    after = (problem.poses.array(), problem.targets, problem.a, problem.speed)
    assert all(np.array_equal(b, a) for b, a in zip(before, after, strict=True))
