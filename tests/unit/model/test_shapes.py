"""What holds for every shape: NumPy against textbook geometry, and scalars against NumPy."""

import math

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from pydantic import ValidationError
from support.geometry import gap, meets
from support.shapes import GRID, L_SHAPE, POLYGONS, SHAPES, circles, combs, rectangles

from tetractl.control.kernels.options import inlined
from tetractl.core.registries import SHAPES as REGISTRY
from tetractl.model.shapes.polygon import Polygon

PLACES = st.floats(-12, 12)
ENDS = GRID | PLACES
MARGINS = st.sampled_from([0.0, 0.25, 1.0])


def at(*numbers):
    return [np.array([float(n)]) for n in numbers]


def polygon(*vertices):
    return Polygon(type="polygon", vertices=vertices)


def row(shape):
    return np.array(shape.row()) if shape.packed.size is None else shape.row()


def scalar(shape, name):
    """A compiled function of a shape: as a kernel compiles it, and as plain Python."""
    function = getattr(shape.packed, name)
    return inlined(function), function


def test_the_strategies_know_every_kind_that_is_built_in():
    assert set(REGISTRY.builtin) == {"rectangle", "circle", "polygon"}


@given(SHAPES, PLACES, PLACES)
def test_the_distance_is_that_of_geometry(shape, x, y):
    expected = gap(shape, x, y)
    assert shape.distance(*at(x, y))[0] == pytest.approx(expected, abs=1e-9)
    if abs(expected) > 1e-9:
        assert shape.contain(*at(x, y))[0] == (expected < 0)


@given(SHAPES, ENDS, ENDS, ENDS, ENDS)
def test_a_segment_crosses_as_geometry_says_but_for_rounding(shape, x0, y0, x1, y1):
    crossed = shape.cross(*at(x0, y0, x1, y1))[0]
    if meets(shape, x0, y0, x1, y1):
        assert shape.grown(1e-9).cross(*at(x0, y0, x1, y1))[0]
    t = np.linspace(0, 1, 2001)
    nearest = shape.distance(x0 + t * (x1 - x0), y0 + t * (y1 - y0)).min()
    step = math.dist((x0, y0), (x1, y1)) / 2000
    if nearest < -1e-9:
        assert crossed
    if nearest > step + 1e-9:  # a sample is within half a step of every point of the segment
        assert not crossed


@given(rectangles() | circles() | combs() | st.just(L_SHAPE), GRID, GRID)
def test_a_segment_without_length_is_a_point(shape, x, y):
    assert shape.cross(*at(x, y, x, y))[0] == shape.contain(*at(x, y))[0]


@given(SHAPES, PLACES, PLACES, PLACES, PLACES, MARGINS)
def test_a_grown_shape_holds_all_within_the_margin(shape, x0, y0, x1, y1, margin):
    grown = shape.grown(margin)
    for x, y in ((x0, y0), (x1, y1)):
        if gap(shape, x, y) <= margin - 1e-9:
            assert grown.contain(*at(x, y))[0]
        assert grown.distance(*at(x, y))[0] <= gap(shape, x, y) - margin + 1e-9
        if grown.distance(*at(x, y))[0] > 1e-9:
            assert not grown.contain(*at(x, y))[0]
    t = np.linspace(0, 1, 101)
    if shape.distance(x0 + t * (x1 - x0), y0 + t * (y1 - y0)).min() <= margin - 1e-9:
        assert grown.cross(*at(x0, y0, x1, y1))[0]
    assert shape.margin == 0
    assert grown.grown(margin).margin == 2 * margin


@given(circles() | POLYGONS, PLACES, PLACES, PLACES, PLACES, MARGINS)
def test_discs_and_polygons_grow_by_the_margin_and_no_more(shape, x0, y0, x1, y1, margin):
    grown = shape.grown(margin)
    assert grown.distance(*at(x0, y0))[0] == pytest.approx(gap(shape, x0, y0) - margin, abs=1e-9)
    t = np.linspace(0, 1, 2001)
    nearest = shape.distance(x0 + t * (x1 - x0), y0 + t * (y1 - y0)).min()
    if nearest > margin + math.dist((x0, y0), (x1, y1)) / 2000 + 1e-9:
        assert not grown.cross(*at(x0, y0, x1, y1))[0]


@given(SHAPES, PLACES, PLACES, PLACES, PLACES, MARGINS)
def test_the_scalar_functions_agree_with_numpy(shape, x0, y0, x1, y1, margin):
    shape = shape.grown(margin)
    distance, p = shape.distance(*at(x0, y0))[0], row(shape)
    crossed = shape.cross(*at(x0, y0, x1, y1))[0]
    wider, tighter = shape.grown(1e-7), None if margin == 0 else shape.grown(-1e-7)
    for gap_of in scalar(shape, "gap"):
        if abs(distance) > 1e-9:
            assert (gap_of(x0, y0, p) <= 0) == (distance < 0)
    for between in scalar(shape, "gap_between"):
        met = between(x0, y0, x1, y1, p) <= 0
        if met != crossed:  # only where the segment just touches
            assert wider.cross(*at(x0, y0, x1, y1))[0]
            assert tighter is None or not tighter.cross(*at(x0, y0, x1, y1))[0]
    for depth in scalar(shape, "depth"):
        if distance < 0:
            assert depth(x0, y0, p) == pytest.approx(-distance, abs=1e-9)
        else:
            assert depth(x0, y0, p) <= 1e-9


def convex(shape):
    """Whether the outline, anticlockwise, never turns right."""
    sides = np.diff(shape.outline(), axis=0, append=shape.outline()[:1])
    after = np.roll(sides, -1, axis=0)
    return bool((sides[:, 0] * after[:, 1] - sides[:, 1] * after[:, 0] >= 0).all())


@given(SHAPES, PLACES, PLACES, MARGINS)
@example(
    Polygon(type="polygon", vertices=((0, 0), (4, 0), (4, 1), (1, 1), (1, 3), (0, 3))),
    2.0,
    2.0,
    0.0,
)
def test_outward_leads_out_by_the_depth(shape, x, y, margin):
    assume(margin == 0 or convex(shape))  # in a notch, no one direction leads past both its edges
    shape = shape.grown(margin)
    p = row(shape)
    _, depth_of = scalar(shape, "depth")
    depth = depth_of(x, y, p)
    for outward in scalar(shape, "outward"):
        east, north = outward(x, y, p)
        assert math.hypot(east, north) == pytest.approx(1, abs=1e-6)
        if depth > 1e-6:
            out = shape.distance(*at(x + depth * east, y + depth * north))[0]
            assert out == pytest.approx(0, abs=1e-6)
        elif depth < -1e-6:
            # midway between two edges of a notch, away from one is along the other
            edge = shape.distance(*at(x + depth * east, y + depth * north))[0]
            away = depth_of(x + 0.01 * east, y + 0.01 * north, p)
            assert away < depth or edge == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize(
    ("x", "y", "out"), [(2, 0, (0, -1)), (4, 0.5, (1, 0)), (1, 2, (1, 0)), (3, 1, (0, 1))]
)
def test_outward_of_a_point_on_an_edge_is_its_normal(x, y, out):
    assert L_SHAPE.packed.outward(x, y, row(L_SHAPE)) == out


@given(SHAPES)
def test_the_outline_draws_the_shape(shape):
    outline = shape.outline()
    assert np.abs(shape.distance(*outline.T)).max() < 1e-9
    assert np.abs(shape.grown(2.0).outline() - outline).max() == 0
    x, y = outline.T
    area = np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) / 2
    assert area > 0
    drawn = Polygon(type="polygon", vertices=tuple(map(tuple, outline.tolist())))
    spots = np.random.default_rng(1).uniform(-12, 12, (2, 300))
    clear = np.abs(shape.distance(*spots)) > 0.02  # an outline of a disc cuts its edge by as much
    assert np.array_equal(drawn.contain(*spots)[clear], shape.contain(*spots)[clear])


@pytest.mark.parametrize(
    ("x", "y", "inside"),
    [(0, 0, True), (4, 1, True), (1, 1, True), (1, 2, True), (1.01, 2, False), (2, 1.01, False),
     (0.5, 2.9, True), (2.5, 2, False), (0, 3, True), (-0.01, 1, False)],
)  # fmt: skip
def test_edges_and_the_inner_corner_belong_to_a_concave_polygon(x, y, inside):
    assert L_SHAPE.contain(*at(x, y))[0] == inside
    assert L_SHAPE.cross(*at(x, y, x, y))[0] == inside


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
    assert L_SHAPE.cross(*at(*segment))[0] == crosses
    assert L_SHAPE.cross(*at(*segment[2:], *segment[:2]))[0] == crosses


def test_the_way_round_a_polygon_does_not_matter():
    back = polygon(*L_SHAPE.vertices[::-1])
    assert back.outline().tolist() == L_SHAPE.outline().tolist()
    assert back.distance(*at(0.5, 0.5))[0] == L_SHAPE.distance(*at(0.5, 0.5))[0] == -0.5


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
        ([(0, 0), (0, 0), (1, 1), (1, 0)], "the corner [0, 0] twice in a row"),
    ],
)
def test_a_polygon_that_is_none_is_refused(vertices, message):
    with pytest.raises(ValidationError) as caught:
        polygon(*vertices)
    (problem,) = caught.value.errors()
    assert message in problem["msg"] or problem["type"] == message
    assert problem["loc"] == ("vertices",) or problem["ctx"]["field"] == "vertices"
