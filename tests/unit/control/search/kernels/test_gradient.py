import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit import problems

from tetractl.control.search.cost import predict
from tetractl.control.search.kernels import gradient
from tetractl.control.search.kernels.gradient import Trace
from tetractl.control.search.kernels.motion import flatten
from tetractl.tools.kernels.kernel_cache import compiled

pytestmark = pytest.mark.slow


@compiled()
def trace(*args):
    gradient.trace(*args)


@compiled()
def backward(*args):
    gradient.backpropagate(*args)


MODELS = st.sampled_from(["euler", "exact"])


def traced(problem, signals):
    path = Trace.allocate(len(problem.a), len(signals))
    trace(signals, flatten(problem), path)
    return path


def turning(problem, seed):
    """Return a problem of robots that turn faster to one side, and some of which saturate."""
    count = len(problem.a)
    rng = np.random.default_rng([seed, 1])
    saturation = np.where(rng.random(count) < 0.5, 1.0, rng.uniform(0.2, 1, count))
    return replace(problem, side=rng.uniform(-0.3, 0.3, count), saturation=saturation)


@given(
    seed=st.integers(0, 2**32),
    robots=st.integers(1, 4),
    length=st.integers(1, 30),
    model=MODELS,
    first=st.floats(0.01, 0.3),
    drifts=st.booleans(),
    turns=st.booleans(),
)
def test_the_path_is_the_predicted_one(seed, robots, length, model, first, drifts, turns):
    problem = problems.problem(problems.world(seed, robots, model=model), drifts=drifts)
    problem = turning(replace(problem, first_period=first), seed) if turns else problem
    signals = np.random.default_rng(seed).uniform(-math.pi, math.pi, length)
    found = traced(problem, signals)
    path = np.stack([found.x, found.y])[:, :, :length]
    expected = predict(problem, signals)[1:, :, :2].transpose(2, 1, 0)
    assert path == pytest.approx(expected, rel=1e-10, abs=1e-10 * abs(expected).max())


@given(
    seed=st.integers(0, 2**32),
    robots=st.integers(1, 3),
    length=st.integers(1, 20),
    model=MODELS,
    last=st.floats(0, 1),
)
def test_the_gradient_is_that_of_the_path(seed, robots, length, model, last):
    """`backward` against central differences of the readable model, in a random direction."""
    problem = problems.problem(problems.world(seed, robots, model=model), drifts=robots > 1)
    rng = np.random.default_rng(seed)
    signals = rng.uniform(-math.pi, math.pi, length)
    toward = rng.normal(size=length)
    step = 1e-6
    robot = int(rng.integers(robots))
    place = int(last * (length - 1))
    east, north = rng.normal(size=2)
    rows = np.zeros((1, length))
    backward(traced(problem, signals), robot, place, east, north, rows[0])
    ahead = predict(problem, signals + step * toward)[place + 1, robot, :2]
    behind = predict(problem, signals - step * toward)[place + 1, robot, :2]
    numeric = float((ahead - behind) @ [east, north]) / (2 * step)
    assert float(rows[0] @ toward) == pytest.approx(numeric, rel=1e-5, abs=1e-4)
    assert not rows[0, place + 1 :].any()


@pytest.mark.parametrize("heading", [0.0, 1e-9, math.pi - 1e-9, -math.pi])
@pytest.mark.parametrize("model", ["euler", "exact"])
def test_a_robot_along_or_against_the_direction_has_a_finite_gradient(model, heading):
    problem = problems.problem(problems.world(5, 1, model=model))
    poses = replace(problem.poses, heading=np.array([heading]))
    found = traced(replace(problem, poses=poses), np.zeros(10))
    for slope in (
        found.x_by_heading,
        found.y_by_heading,
        found.x_by_u,
        found.y_by_u,
        found.heading_kept,
    ):
        assert np.isfinite(slope).all()
