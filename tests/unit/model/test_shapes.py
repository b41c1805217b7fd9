"""What holds for every shape: NumPy against textbook geometry, and scalars against NumPy."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numba import njit
from pydantic import ValidationError
from support.geometry import gap, meets
from support.shapes import GRID, L_SHAPE, SHAPES, circles, combs, rectangles

from tetractl.control.kernels import obstacles as kernel
from tetractl.core.registries import SHAPES as REGISTRY
from tetractl.core.shape import Shape
from tetractl.model.obstacles import Obstacles
from tetractl.model.shapes.polygon import Polygon

pytestmark = pytest.mark.slow

PLACES = st.floats(-12, 12)
ENDS = GRID | PLACES
MARGINS = st.sampled_from([0.0, 0.25, 1.0])


def at(*numbers):
    return [np.array([float(n)]) for n in numbers]


def polygon(*vertices):
    return Polygon(type="polygon", vertices=vertices)


@njit
def compiled(row, x0, y0, x1, y1):
    """Whether a segment touches, and the distance and direction of its start, by the kernels."""
    return kernel.touches(row, x0, y0, x1, y1), kernel.nearest(row, x0, y0)


def row(shape):
    return Obstacles.of((shape,)).rows[0]


def test_the_strategies_know_every_kind_that_is_built_in():
    assert set(REGISTRY.builtin) == {"rectangle", "circle", "polygon"}


@given(SHAPES, PLACES, PLACES)
def test_the_distance_is_that_of_geometry(section, x, y):
    expected = gap(section, x, y)
    shape = section.shape()
    assert shape.distance(*at(x, y))[0] == pytest.approx(expected, abs=1e-9)
    if abs(expected) > 1e-9:
        assert shape.contain(*at(x, y))[0] == (expected < 0)


@given(SHAPES, ENDS, ENDS, ENDS, ENDS)
def test_a_segment_crosses_as_geometry_says_but_for_rounding(section, x0, y0, x1, y1):
    shape = section.shape()
    crossed = shape.cross(*at(x0, y0, x1, y1))[0]
    if meets(section, x0, y0, x1, y1):
        assert shape.grown(1e-9).cross(*at(x0, y0, x1, y1))[0]
    t = np.linspace(0, 1, 2001)
    nearest = shape.distance(x0 + t * (x1 - x0), y0 + t * (y1 - y0)).min()
    step = math.dist((x0, y0), (x1, y1)) / 2000
    if nearest < -1e-9:
        assert crossed
    if nearest > step + 1e-9:  # a sample is within half a step of every point of the segment
        assert not crossed


@given(rectangles() | circles() | combs() | st.just(L_SHAPE), GRID, GRID)
def test_a_segment_without_length_is_a_point(section, x, y):
    shape = section.shape()
    assert shape.cross(*at(x, y, x, y))[0] == shape.contain(*at(x, y))[0]


@given(SHAPES, PLACES, PLACES, PLACES, PLACES, MARGINS)
def test_shapes_grow_by_the_margin_and_no_more(section, x0, y0, x1, y1, margin):
    shape = section.shape()
    grown = shape.grown(margin)
    expected = gap(section, x0, y0) - margin
    assert grown.distance(*at(x0, y0))[0] == pytest.approx(expected, abs=1e-9)
    t = np.linspace(0, 1, 2001)
    nearest = shape.distance(x0 + t * (x1 - x0), y0 + t * (y1 - y0)).min()
    crossed = grown.cross(*at(x0, y0, x1, y1))[0]
    if nearest <= margin - 1e-9:
        assert crossed
    if nearest > margin + math.dist((x0, y0), (x1, y1)) / 2000 + 1e-9:
        assert not crossed


@given(SHAPES, PLACES, PLACES, PLACES, PLACES, MARGINS)
@example(L_SHAPE, 2.0, 2.0, 0.0, 0.0, 0.0)
@example(L_SHAPE, 4.0, 0.5, 0.0, 0.0, 0.0)  # on an edge
def test_the_kernels_agree(section, x0, y0, x1, y1, margin):
    shape = section.shape().grown(margin)
    numbers = row(shape)
    touches, (distance, east, north) = compiled(numbers, x0, y0, x1, y1)
    assert distance == pytest.approx(shape.distance(*at(x0, y0))[0], abs=1e-9)
    wider = shape.grown(1e-7)
    tighter = None if margin == 0 else shape.grown(-1e-7)
    if touches != shape.cross(*at(x0, y0, x1, y1))[0]:  # only where the segment just touches
        assert wider.cross(*at(x0, y0, x1, y1))[0]
        assert tighter is None or not tighter.cross(*at(x0, y0, x1, y1))[0]
    assert math.hypot(east, north) == pytest.approx(1, abs=1e-6)
    if distance < -1e-6 and margin == 0:
        # out by the depth is the edge; out of a grown notch, no one direction leads
        out = shape.distance(*at(x0 - distance * east, y0 - distance * north))[0]
        assert out == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize(
    ("x", "y", "out"), [(2, 0, (0, -1)), (4, 0.5, (1, 0)), (1, 2, (1, 0)), (3, 1, (0, 1))]
)
def test_outward_of_a_point_on_an_edge_is_its_normal(x, y, out):
    distance = compiled(row(L_SHAPE.shape()), float(x), float(y), float(x), float(y))[1]
    assert distance[1:] == out


def test_two_corners_with_a_radius_are_a_capsule():
    capsule = Shape(np.array([[0.0, 0], [4, 0]]), 1.0)
    x = np.array([2.0, 6, -1, 2])
    y = np.array([0.0, 0, 0, 3])
    assert capsule.distance(x, y).tolist() == [-1, 1, 0, 2]
    assert capsule.cross(*at(2, 3, 2, -3))[0]
    assert not capsule.cross(*at(4.8, 1, 6, -1))[0]
    assert compiled(row(capsule), 2.0, 3.0, 2.0, -3.0)[0]
    assert capsule.distance(*capsule.outline().T) == pytest.approx(0, abs=1e-12)


@given(SHAPES)
def test_the_outline_draws_the_shape(section):
    shape = section.shape()
    outline = shape.outline()
    assert np.abs(shape.distance(*outline.T)).max() < 1e-9
    x, y = outline.T
    area = np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) / 2
    assert area > 0
    drawn = Polygon(type="polygon", vertices=tuple(map(tuple, outline.tolist()))).shape()
    spots = np.random.default_rng(1).uniform(-12, 12, (2, 300))
    clear = np.abs(shape.distance(*spots)) > 0.02  # an outline of a disc cuts its edge by as much
    assert np.array_equal(drawn.contain(*spots)[clear], shape.contain(*spots)[clear])


@pytest.mark.parametrize(
    ("x", "y", "inside"),
    [(0, 0, True), (4, 1, True), (1, 1, True), (1, 2, True), (1.01, 2, False), (2, 1.01, False),
     (0.5, 2.9, True), (2.5, 2, False), (0, 3, True), (-0.01, 1, False)],
)  # fmt: skip
def test_edges_and_the_inner_corner_belong_to_a_concave_polygon(x, y, inside):
    assert L_SHAPE.shape().contain(*at(x, y))[0] == inside
    assert L_SHAPE.shape().cross(*at(x, y, x, y))[0] == inside


@pytest.mark.parametrize(
    ("segment", "crosses"),
    [
        ((1.5, 3, 1.5, 1.5), False),  # into the notch of the L, short of it
        ((1.5, 3, 4, 1.5), False),  # past both arms
        ((1.5, 3, 4, 0.5), True),
        ((1, 5, 1, 3), True),  # ends on a corner
        ((1.5, 1, 3, 1), True),  # along an edge
        ((0.2, 0.2, 0.3, 0.4), True),  # inside throughout
        ((-1, -1, 5, -1), False),
        ((-1, 1, 5, 4), True),  # right across
    ],
)
def test_segments_against_a_concave_polygon(segment, crosses):
    assert L_SHAPE.shape().cross(*at(*segment))[0] == crosses
    assert L_SHAPE.shape().cross(*at(*segment[2:], *segment[:2]))[0] == crosses


def test_the_way_round_a_polygon_does_not_matter():
    back = polygon(*L_SHAPE.vertices[::-1])
    assert back.shape().outline().tolist() == L_SHAPE.shape().outline().tolist()
    assert (
        back.shape().distance(*at(0.5, 0.5))[0]
        == L_SHAPE.shape().distance(*at(0.5, 0.5))[0]
        == -0.5
    )


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
