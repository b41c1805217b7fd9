"""Tests of every shape: NumPy against textbook geometry, and scalars against NumPy."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numba import njit
from pydantic import ValidationError
from testkit.geometry import gap, meets, to_segment
from testkit.shapes import GRID, L_SHAPE, SHAPES

from tetractl.control.search.kernels import obstacles as kernel
from tetractl.core.registries import SHAPES as REGISTRY
from tetractl.core.shape import Shape, squared_distance_of_segments
from tetractl.model.shapes import Polygon

pytestmark = pytest.mark.slow

PLACES = st.floats(-12, 12)
ENDS = GRID | PLACES
MARGINS = st.sampled_from([0.0, 0.25, 1.0])
SAMPLES = 2000
L = L_SHAPE.shape()


def at(*numbers):
    return [np.array([float(n)]) for n in numbers]


def polygon(*vertices):
    return Polygon(type="polygon", vertices=vertices)


def contains(shape, x, y):
    """Whether the shape contains a single point."""
    return bool(shape.contains(*at(x, y))[0])


def crosses(shape, x0, y0, x1, y1):
    """Whether a single segment touches the shape."""
    return bool(shape.meets_segments(*at(x0, y0, x1, y1))[0])


def distance(shape, x, y):
    """The distance of a single point, negative inside."""
    return float(shape.distance(*at(x, y))[0])


def least_distance(shape, x0, y0, x1, y1):
    """The least distance of SAMPLES + 1 points of a segment."""
    t = np.linspace(0, 1, SAMPLES + 1)
    return shape.distance(x0 + t * (x1 - x0), y0 + t * (y1 - y0)).min()


@njit
def compiled_touches(corners, radius, x0, y0, x1, y1):
    return kernel.touches(corners, len(corners), radius, x0, y0, x1, y1)


@njit
def compiled_nearest(corners, radius, x, y):
    return kernel.distance_and_normal(corners, len(corners), radius, x, y)


def test_the_strategies_know_every_kind_that_is_built_in():
    assert set(REGISTRY.builtin) == {"rectangle", "circle", "polygon"}


@given(SHAPES, PLACES, PLACES)
def test_the_distance_is_that_of_geometry(section, x, y):
    expected = gap(section, x, y)
    shape = section.shape()
    assert distance(shape, x, y) == pytest.approx(expected, abs=1e-9)
    if abs(expected) > 1e-9:
        assert contains(shape, x, y) == (expected < 0)


@given(SHAPES, ENDS, ENDS, ENDS, ENDS)
def test_a_segment_crosses_as_geometry_says_but_for_rounding(section, x0, y0, x1, y1):
    shape = section.shape()
    segment = (x0, y0, x1, y1)
    if meets(section, *segment):
        assert crosses(shape.grown(1e-9), *segment)
    nearest = least_distance(shape, *segment)
    step = math.dist((x0, y0), (x1, y1)) / SAMPLES
    if nearest < -1e-9:
        assert crosses(shape, *segment)
    if nearest > step + 1e-9:  # a sample is within half a step of every point of the segment
        assert not crosses(shape, *segment)


@given(ENDS, ENDS, ENDS, ENDS, ENDS, ENDS, ENDS, ENDS)
def test_two_segments_are_as_far_apart_as_their_nearest_points(x0, y0, x1, y1, ax, ay, bx, by):
    points = 500
    of_points = [
        to_segment(x0 + t * (x1 - x0), y0 + t * (y1 - y0), ax, ay, bx, by)
        for t in np.linspace(0, 1, points + 1)
    ]
    apart = math.sqrt(squared_distance_of_segments(x0, y0, x1, y1, ax, ay, bx, by))
    step = math.dist((x0, y0), (x1, y1)) / points
    assert min(of_points) - step - 1e-6 <= apart <= min(of_points) + 1e-6


@given(SHAPES, PLACES, PLACES, PLACES, PLACES, MARGINS)
def test_shapes_grow_by_the_margin_and_no_more(section, x0, y0, x1, y1, margin):
    shape = section.shape()
    grown = shape.grown(margin)
    expected = gap(section, x0, y0) - margin
    assert distance(grown, x0, y0) == pytest.approx(expected, abs=1e-9)
    nearest = least_distance(shape, x0, y0, x1, y1)
    step = math.dist((x0, y0), (x1, y1)) / SAMPLES
    if nearest <= margin - 1e-9:
        assert crosses(grown, x0, y0, x1, y1)
    if nearest > margin + step + 1e-9:
        assert not crosses(grown, x0, y0, x1, y1)


@pytest.mark.long
@given(SHAPES, PLACES, PLACES, PLACES, PLACES, MARGINS)
@example(L_SHAPE, 2.0, 2.0, 0.0, 0.0, 0.0)
@example(L_SHAPE, 4.0, 0.5, 0.0, 0.0, 0.0)  # on an edge
def test_the_kernels_agree(section, x0, y0, x1, y1, margin):
    shape = section.shape().grown(margin)
    touches = compiled_touches(shape.corners.copy(), shape.radius, x0, y0, x1, y1)
    if touches != crosses(shape, x0, y0, x1, y1):  # only where the segment just touches
        assert crosses(shape.grown(1e-7), x0, y0, x1, y1)
        assert margin == 0 or not crosses(shape.grown(-1e-7), x0, y0, x1, y1)
    gap_size, east, north = compiled_nearest(shape.corners.copy(), shape.radius, x0, y0)
    assert gap_size == pytest.approx(distance(shape, x0, y0), abs=1e-9)
    assert math.hypot(east, north) == pytest.approx(1, abs=1e-6)
    if gap_size < -1e-6 and margin == 0:
        # out by the depth is the edge; out of a grown notch, no one direction leads
        edge = (x0 - gap_size * east, y0 - gap_size * north)
        assert distance(shape, *edge) == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize(
    ("x", "y", "out"),
    [(2.0, 0.0, (0, -1)), (4.0, 0.5, (1, 0)), (1.0, 2.0, (1, 0)), (3.0, 1.0, (0, 1))],
)
def test_outward_of_a_point_on_an_edge_is_its_normal(x, y, out):
    _, east, north = compiled_nearest(L.corners.copy(), L.radius, x, y)
    assert (east, north) == out


def test_two_corners_with_a_radius_are_a_capsule():
    capsule = Shape(np.array([[0.0, 0], [4, 0]]), 1.0)
    x = np.array([2.0, 6, -1, 2])
    y = np.array([0.0, 0, 0, 3])
    assert capsule.distance(x, y).tolist() == [-1, 1, 0, 2]
    assert crosses(capsule, 2, 3, 2, -3)
    assert not crosses(capsule, 4.8, 1, 6, -1)
    assert compiled_touches(capsule.corners, capsule.radius, 2.0, 3.0, 2.0, -3.0)
    assert capsule.distance(*capsule.outline().T) == pytest.approx(0, abs=1e-12)


@given(SHAPES)
def test_the_outline_draws_the_shape(section):
    shape = section.shape()
    outline = shape.outline()
    assert np.abs(shape.distance(*outline.T)).max() < 1e-9
    x, y = outline.T
    area = np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) / 2
    assert area > 0
    drawn = polygon(*outline.tolist()).shape()
    spots = np.random.default_rng(1).uniform(-12, 12, (2, 300))
    clear = np.abs(shape.distance(*spots)) > 0.02  # an outline of a disc cuts its edge by as much
    assert np.array_equal(drawn.contains(*spots)[clear], shape.contains(*spots)[clear])


@pytest.mark.parametrize(
    ("vertices", "message"),
    [
        ([(0, 0), (1, 1)], "too_short"),
        ([(0, 0), (2, 0), (1, 0)], "turns back on itself at [0, 0]"),
        ([(0, 0), (1, 0), (2, 0), (0, 0)], "twice in a row"),
        ([(0, 0), (2, 2), (2, 0), (0, 2)], "crosses or touches itself"),
        ([(0, 0), (4, 0), (2, 0), (2, 2)], "turns back on itself at [4, 0]"),
        ([(0, 0), (4, 0), (4, 4), (2, 0), (0, 4)], "crosses or touches itself"),
        ([(0, 0), (1e-200, 0), (0, 1e-200)], "too small to compute"),
        ([(0, 0), (1e200, 0), (0, 1e200)], "too large or too small to compute"),
        ([(0, 0), (0, 0), (1, 1), (1, 0)], "the corner [0, 0] twice in a row"),
    ],
)
def test_a_polygon_that_is_none_is_refused(vertices, message):
    with pytest.raises(ValidationError) as caught:
        polygon(*vertices)
    (problem,) = caught.value.errors()
    assert message in problem["msg"] or problem["type"] == message
    assert problem["loc"] == ("vertices",) or problem["ctx"]["field"] == "vertices"
