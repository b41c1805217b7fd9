"""Tests of compiled contacts and depths against the readable region, also at the edges themselves.

On the grid of the shapes, corners and edges are touched exactly.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit import problems
from testkit.shapes import GRID, L_SHAPE, SHAPES, circles, rectangles

from tetractl.control.search.kernels import obstacles as kernels
from tetractl.control.search.kernels.levenberg import workspace_for
from tetractl.control.search.kernels.motion import flatten
from tetractl.control.search.kernels.obstacles import arrays_of
from tetractl.control.search.kernels.rollout import rollouts_of
from tetractl.core.obstacles import Obstacles
from tetractl.core.setup import Bounds
from tetractl.tools.kernels.kernel_cache import compiled

pytestmark = pytest.mark.slow

WALLS = st.none() | st.just(Bounds(-5.0, -4.0, 6.0, 4.5))
REGIONS = st.builds(
    lambda sections, margin, walls: Obstacles.from_shapes(
        [section.shape() for section in sections], margin, walls
    ),
    st.lists(SHAPES, min_size=0, max_size=3),
    st.sampled_from([0.0, 0.25, 1.0]),
    WALLS,
)
COORDINATES = GRID.map(float) | st.floats(-8, 8)
POINTS = st.tuples(COORDINATES, COORDINATES)


@compiled()
def count_hits(*args):
    kernels.count_hits(*args)


@compiled()
def find_deepest(*args):
    kernels.find_deepest(*args)


@compiled()
def outward(obstacles, o, x, y):
    return kernels.outward(obstacles, o, x, y)


@compiled()
def box(obstacles, o):
    return kernels.box(obstacles, o)


def problem_in(region, swept=False, robots=2):
    problem = problems.problem(problems.world(1, robots, 0, swept=swept))
    return replace(problem, obstacles=region)


@given(REGIONS, st.lists(st.tuples(POINTS, POINTS), min_size=1, max_size=9), st.booleans())
def test_a_robot_is_hit_where_the_readable_region_says_so(region, moves, swept):
    """The second robot of two; the hits of the first, and those from before, stay."""
    before, after = np.array(moves).transpose(1, 2, 0)
    contacts = rollouts_of(0, 2, len(moves)).contacts
    contacts.hits[:] = [[7.0], [3.0]]
    contacts.x_before[:], contacts.y_before[:] = before
    x, y = np.full((2, 2, len(moves)), 1e6)
    x[1], y[1] = after
    count_hits(flatten(problem_in(region, swept)), x, y, 1, contacts)
    expected = region.meets_segments(*before, *after) if swept else region.contains(*after)
    assert (contacts.hits[1] - 3 > 0).tolist() == np.broadcast_to(expected, len(moves)).tolist()
    assert set(contacts.hits[1]) <= {3.0, 4.0}  # a step counts once, however many obstacles it hits
    assert (contacts.hits[0] == 7).all()


@given(REGIONS, st.lists(POINTS, min_size=1, max_size=9), st.sampled_from([0.5, 2.0]))
def test_the_deepest_position_in_each_obstacle_is_found(region, points, slack):
    problem = problem_in(region)
    room = workspace_for(problem, len(points))
    x, y = np.array(points).T
    width = room.path.x.shape[1]
    room.path.x[:], room.path.y[:] = 0.0, 0.0  # what is beyond the last signal has no meaning
    room.path.x[0, : len(x)], room.path.y[0, : len(x)] = x, y
    room.path.x[1, : len(x)], room.path.y[1, : len(x)] = x[::-1], y[::-1]
    assert width >= len(x)
    find_deepest(flatten(problem), -slack, room)
    depths = -region.distances(x, y)
    for o in range(region.count):
        deepest = depths[o].max()
        for robot, of_robot in ((0, depths[o]), (1, depths[o][::-1])):
            assert room.depths[robot, o] == pytest.approx(max(deepest, -slack), abs=1e-12)
            if deepest > -slack:
                assert room.deepest_signal[robot, o] == np.argmax(
                    of_robot
                )  # the first of equal ones


@given(rectangles() | circles(), st.sampled_from([0.0, 0.25, 1.0]), POINTS)
def test_outwards_the_distance_of_an_obstacle_grows_as_fast_as_the_way(section, margin, point):
    """Of convex shapes; out of a concave one, another edge may be as near."""
    region = Obstacles.from_shapes([section.shape()], margin)
    x, y = point
    east, north = outward(arrays_of(region), 0, x, y)
    assert math.hypot(east, north) == pytest.approx(1)
    way = 1e-6
    before, after = region.distance(x + np.array([0, way * east]), y + np.array([0, way * north]))
    assert after - before == pytest.approx(way, rel=1e-3)


@pytest.mark.parametrize(
    ("point", "direction"),
    [
        ((0.9, 2.0), (1, 0)),  # in the upright part of the L
        ((0.2, 2.0), (-1, 0)),
        ((1.3, 2.0), (1, 0)),  # in its notch
        ((2.0, 1.3), (0, 1)),
        ((3.0, 0.9), (0, 1)),
        ((-3.0, -4.0), (-0.6, -0.8)),
    ],
)
def test_the_way_out_of_a_concave_shape_leads_from_its_nearest_edge(point, direction):
    arrays = arrays_of(Obstacles.from_shapes([L_SHAPE.shape()]))
    assert outward(arrays, 0, *point) == pytest.approx(direction)


@pytest.mark.parametrize(
    ("point", "direction"),
    [((1.0, 0.0), (0, -1)), ((2.0, 1.0), (1, 0)), ((1.0, 2.0), (0, 1)), ((0.0, 1.0), (-1, 0))],
)
def test_on_an_edge_outwards_is_the_edges_normal(point, direction):
    """Of a square of side 2, whose corners go round counter-clockwise as all shapes' do."""
    section = problems.Rectangle(type="rectangle", left=0, bottom=0, width=2, height=2)
    arrays = arrays_of(Obstacles.from_shapes([section.shape()], 0.5))
    assert outward(arrays, 0, *point) == pytest.approx(direction)


def test_at_a_circles_centre_there_is_a_way_out():
    section = problems.Circle(type="circle", center=(3, 4), radius=2)
    arrays = arrays_of(Obstacles.from_shapes([section.shape()]))
    assert math.hypot(*outward(arrays, 0, 3.0, 4.0)) == 1


def test_each_wall_is_left_towards_the_middle():
    arrays = arrays_of(Obstacles.from_shapes([], 0.0, Bounds(-5, -4, 6, 4)))
    directions = [outward(arrays, o, 20.0, 30.0) for o in range(4)]
    assert directions == [(1, 0), (0, 1), (-1, 0), (0, -1)]


@given(SHAPES, st.floats(0, 2))
def test_a_box_is_that_of_the_grown_shape(section, margin):
    region = Obstacles.from_shapes([section.shape()], margin)
    assert box(arrays_of(region), 0) == pytest.approx(region.shapes[0].box)
