"""Tests of what is checked along paths, against slow checks and in any division into parts."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from testkit import batches

from tetractl.core.obstacles import Obstacles
from tetractl.core.poses import Poses
from tetractl.core.setup import Bounds
from tetractl.model import path_check
from tetractl.model.path_check import COMPARE_ALL_MAX, PathCheck, check_path, compute_separations
from tetractl.model.shapes import Circle, Rectangle

pytestmark = pytest.mark.slow

ARENA = Bounds(-100, 50, 1900, 1550)
BOX = Rectangle(type="rectangle", left=700, bottom=600, width=200, height=150).shape()
DISC = Circle(type="circle", center=(1200, 1000), radius=120).shape()
OBSTACLES = Obstacles.from_shapes([BOX, DISC])
SEEDS = st.integers(0, 2**32)


def wander(seed, samples, robots=3, known=1.0):
    """Paths x, y (M, N) in steps of some 20 mm; a fraction of the samples is known."""
    rng = np.random.default_rng(seed)
    courses = rng.uniform(-np.pi, np.pi, robots) + rng.normal(0, 0.2, (samples, robots)).cumsum(0)
    steps = rng.uniform(0, 40, (samples, robots))
    x = rng.uniform(0, 1800, robots) + (steps * np.cos(courses)).cumsum(axis=0)
    y = rng.uniform(100, 1500, robots) + (steps * np.sin(courses)).cumsum(axis=0)
    lost = rng.random(x.shape) >= known
    x[lost] = np.nan
    y[lost] = np.nan
    return x, y


def checked(parts, obstacles=OBSTACLES):
    check = PathCheck(obstacles, ARENA, parts[0][0].shape[1])
    for x, y in parts:
        check.add(x, y)
    return check


def assert_is_checked_slowly(check, x, y):
    """One robot and one sample after the other."""
    for i in range(x.shape[1]):
        xs, ys = x[:, i], y[:, i]
        clear = OBSTACLES.distance(xs, ys)
        touches = (clear <= 0) | np.append(
            OBSTACLES.meets_segments(xs[:-1], ys[:-1], xs[1:], ys[1:]), False
        )
        assert check.entered[i] == touches.any()
        assert check.clearance[i] == pytest.approx(np.nanmin(clear), abs=1e-9)
        sides = [xs - ARENA.left, ARENA.right - xs, ys - ARENA.bottom, ARENA.top - ys]
        assert check.edge[i] == pytest.approx(np.nanmin(sides), abs=1e-9)
        gaps = [np.hypot(xs - x[:, k], ys - y[:, k]) for k in range(x.shape[1]) if k != i]
        assert check.apart[i] == pytest.approx(np.nanmin(gaps), abs=1e-9)


@given(
    SEEDS,
    st.sampled_from([2, COMPARE_ALL_MAX, COMPARE_ALL_MAX + 1, 3 * COMPARE_ALL_MAX]),
    st.sampled_from([1.0, 0.9]),
)
def test_few_and_many_samples_are_checked_as_one_after_the_other(seed, samples, known):
    x, y = wander(seed, samples, known=known)
    x[0] = y[0] = 500.0  # so that each robot is known at least once
    assert_is_checked_slowly(checked([(x, y)]), x, y)


@settings(max_examples=20)
@given(SEEDS, st.lists(st.integers(1, 2 * COMPARE_ALL_MAX), min_size=1, max_size=4))
def test_it_does_not_matter_how_a_path_is_divided(seed, ends):
    x, y = wander(seed, 2 * COMPARE_ALL_MAX + 20)
    ends = sorted(set(ends))
    parts = list(zip(np.split(x, ends), np.split(y, ends), strict=True))
    whole = checked([(x, y)])
    divided = checked(parts)
    for name in ("entered", "clearance", "edge", "apart"):
        assert getattr(divided, name) == pytest.approx(getattr(whole, name), abs=1e-9)


def test_without_obstacles_nothing_is_entered_and_the_clearance_is_infinite():
    x, y = wander(1, 30)
    check = checked([(x, y)], Obstacles.from_shapes([]))
    assert not check.entered.any()
    assert (check.clearance == np.inf).all()


def test_a_single_robot_is_infinitely_far_from_others():
    assert compute_separations(np.zeros((1, 5)), np.zeros((1, 5))).tolist() == [np.inf]


def test_the_first_and_the_last_robot_are_compared_too():
    x = np.array([[0.0, 0.0], [50.0, 7.0], [0.0, 3.0]])
    assert compute_separations(x, np.zeros_like(x)) == pytest.approx([0, 4, 0])
    assert compute_separations(x[::-1], np.zeros_like(x)) == pytest.approx([0, 4, 0])
    y = np.array([[0.0, 4.0], [90.0, 90.0], [30.0, 8.0]])
    assert compute_separations(x, y) == pytest.approx([5, np.hypot(50, 60), 5])


def test_a_robot_that_is_not_tracked_is_near_to_nobody():
    """Its place is the last known one, and others may be there meanwhile."""
    x = np.array([[0.0, 100.0], [0.0, 1.0], [0.0, 50.0]])
    tracked = np.array([[True, True], [False, True], [True, True]])
    check = PathCheck(OBSTACLES, ARENA, 2)
    check.add(x, np.zeros_like(x), tracked)
    assert check.apart.tolist() == [50, 50]
    check.add(x, np.zeros_like(x))
    assert check.apart.tolist() == [1, 1]


SETUP = replace(batches.experiment(3).setup, obstacles=(BOX, DISC), arena=ARENA)


@settings(max_examples=12)
@given(SEEDS, st.sampled_from([7, 100, 10_000]))
def test_a_recorded_path_is_checked_in_blocks_as_at_once(seed, block):
    x, y = wander(seed, 130)
    rng = np.random.default_rng(seed)
    tracked = rng.random(x.shape) < 0.8
    path = np.stack([x, y, np.zeros_like(x)], axis=-1)
    path[~tracked] = 800.0, 700.0, 0.0  # in the box: what is not tracked must not count
    final = Poses.from_array(path[-1])
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(path_check, "BLOCK_SAMPLES", block)
        verdict = check_path(SETUP, path, tracked, final)
    assert verdict.final is final
    for i in range(3):
        seen = tracked[:, i]
        alone = checked([(x[seen, i, None], y[seen, i, None])])
        assert verdict.entered[i] == alone.entered[0]
        assert verdict.clearance[i] == alone.clearance[0]
        assert verdict.edge[i] == alone.edge[0]
        gaps = [
            np.hypot(x[:, i] - x[:, k], y[:, i] - y[:, k])[seen & tracked[:, k]].min()
            for k in range(3)
            if k != i
        ]
        assert verdict.apart[i] == pytest.approx(min(gaps))


def test_a_robot_that_was_never_tracked_has_entered_nothing():
    path = np.full((4, 3, 3), 800.0)
    verdict = check_path(SETUP, path, np.zeros((4, 3), np.bool_), Poses.from_array(path[-1]))
    assert verdict.entered == (False,) * 3
    assert verdict.clearance == verdict.edge == verdict.apart == (np.inf,) * 3


def test_to_touch_an_edge_is_to_enter():
    beside = np.array([[699.0], [700.0]])
    up = np.full((2, 1), 650.0)
    assert checked([(beside, up)]).entered.tolist() == [True]
    assert checked([(beside[:1], up[:1])]).entered.tolist() == [False]
