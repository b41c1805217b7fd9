import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from testkit import batches
from testkit.geometry import gap
from testkit.shapes import circles, rectangles

from tetractl.core.obstacles import Obstacles
from tetractl.core.poses import Poses
from tetractl.core.setup import Bounds
from tetractl.core.shape import Shape
from tetractl.model.path_check import COMPARE_ALL_MAX, PathCheck, check_path
from tetractl.model.shapes import Circle, Rectangle

pytestmark = pytest.mark.slow

ARENA = Bounds(0, 0, 3000, 3000)
FIELD = Bounds(-2, 1, 5, 5)
PLACES = st.floats(-8, 8)
COORDINATES = st.integers(-6, 9)  # a grid: the edges themselves occur
BOX = Rectangle(type="rectangle", left=1200, bottom=1100, width=200, height=200).shape()
DISC = Circle(type="circle", center=(750, 900), radius=120).shape()
THINGS = st.lists(rectangles() | circles(), min_size=1, max_size=3)


def at(*numbers):
    return [np.array([float(n)]) for n in numbers]


@given(THINGS, PLACES, PLACES)
def test_distance_and_containment_follow_from_geometry(things, x, y):
    world = Obstacles.from_shapes([thing.shape() for thing in things])
    nearest = min(gap(thing, x, y) for thing in things)
    assert world.distance(*at(x, y))[0] == pytest.approx(nearest, abs=1e-12)
    assume(abs(nearest) > 1e-9)
    assert world.contains(*at(x, y))[0] == (nearest < 0)


def test_a_margin_grows_every_side_and_radius():
    grown = Obstacles.from_shapes([BOX, DISC], margin=10)
    assert [shape.box for shape in grown.shapes] == [
        (1190, 1090, 1410, 1310),
        (620, 770, 880, 1030),
    ]
    assert [shape.radius for shape in grown.shapes] == [10, 130]


@given(COORDINATES, COORDINATES, st.integers(0, 2))
def test_what_is_not_well_inside_the_arena_is_in_a_wall(x, y, margin):
    walls = Obstacles.from_shapes([], float(margin), FIELD)
    inside = min(x - FIELD.left, FIELD.right - x, y - FIELD.bottom, FIELD.top - y) > margin
    assert walls.contains(*at(x, y))[0] == (not inside)


def test_a_path_check_sees_what_happens_between_samples_and_between_calls():
    check = PathCheck(Obstacles.from_shapes([BOX]), ARENA, 3)
    # robot 0 stays clear, 1 jumps over the box between two calls, 2 between two samples of a call
    check.add(
        np.array([[0.0, 1500.0, 1000.0], [0.0, 1300.0, 1100.0]]),
        np.array([[0.0, 1000.0, 1200.0], [0.0, 1000.0, 1200.0]]),
    )
    assert check.entered.tolist() == [False, False, False]
    check.add(
        np.array([[900.0, 1300.0, 1500.0], [1100.0, 1300.0, 1600.0]]),
        np.array([[1200.0, 1400.0, 1200.0], [1200.0, 1500.0, 1200.0]]),
    )
    assert check.entered.tolist() == [False, True, True]
    assert check.clearance.tolist() == [100, 100, 100]  # at the samples


@pytest.mark.long
@pytest.mark.parametrize("walls", [None, ARENA])
def test_many_samples_at_once_are_checked_as_one_by_one(walls):
    """Three robots wander by steps of 10 mm; a tenth of their samples is unknown."""
    rng = np.random.default_rng(1)
    disc = Shape(np.array([[700.0, 900.0]]), 60.0)
    obstacles = Obstacles.from_shapes([BOX, disc], 5.0, walls)
    entered = []
    for _ in range(20):
        start_x, start_y = rng.uniform(300, 1500, (2, 3))
        turns = rng.normal(0, 0.1, (COMPARE_ALL_MAX + 50, 3))
        headings = rng.uniform(-np.pi, np.pi, 3) + turns.cumsum(axis=0)
        x = start_x + 10 * np.cos(headings).cumsum(axis=0)
        y = start_y + 10 * np.sin(headings).cumsum(axis=0)
        x[rng.uniform(size=x.shape) < 0.1] = np.nan

        at_once = PathCheck(obstacles, ARENA, 3)
        at_once.add(x, y)
        one_by_one = PathCheck(obstacles, ARENA, 3)
        for m in range(len(x)):
            one_by_one.add(x[m : m + 1], y[m : m + 1])

        for name in ("entered", "clearance", "edge", "apart"):
            assert getattr(at_once, name).tolist() == getattr(one_by_one, name).tolist()
        entered += at_once.entered.tolist()
    assert any(entered) and not all(entered)


def test_a_recorded_path_is_checked_between_the_samples_that_are_known():
    path = np.full((4, 2, 3), np.nan)
    path[[0, 3], 0, :2] = [[1100, 1200], [1500, 1200]]  # through the box; two samples are lost
    path[:, 1, :2] = [[0, 0], [1300, 1200], [0, 0], [0, 0]]
    is_known = np.isfinite(path[..., 0])
    is_known[1, 1] = False  # a reflection in the box, not accepted
    setup = replace(batches.experiment(2).setup, obstacles=(BOX,), arena=ARENA)
    final = Poses.from_array(np.zeros((2, 3)))
    verdict = check_path(setup, path, is_known, final)
    assert verdict.final is final
    assert verdict.entered == (True, False)
    assert verdict.clearance == (100, pytest.approx(math.hypot(1200, 1100)))
    assert verdict.edge == (1100, 0)
    assert verdict.apart == (pytest.approx(math.hypot(1100, 1200)),) * 2


def test_a_path_check_keeps_how_far_out_and_how_near_one_another_robots_came():
    check = PathCheck(Obstacles.from_shapes([]), ARENA, 3)
    check.add(np.array([[100.0, 0.0, 5.0]]), np.array([[100.0, 100.0, 5.0]]))
    check.add(np.array([[100.0, 90.0, -3.0]]), np.array([[100.0, 100.0, 7.0]]))
    assert check.edge.tolist() == [100, 0, -3]
    assert check.apart == pytest.approx([10, 10, math.hypot(5, 95)])
    assert check.verdict(Poses.from_array(np.zeros((3, 3)))).edge == (100, 0, -3)
