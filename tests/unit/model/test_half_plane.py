"""What lies beyond a wall: against arithmetic, and its compiled side against the readable one."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.core.setup import Bounds
from tetractl.model.obstacles import Obstacles
from tetractl.model.shapes.half_plane import HalfPlane, PackedHalfPlanes

ARENA = Bounds(-2, 1, 5, 5)
COORDINATES = st.integers(-6, 9)  # a grid: the edges themselves occur


def at(*numbers):
    return [np.array([float(n)]) for n in numbers]


@given(COORDINATES, COORDINATES, st.integers(0, 2))
def test_what_is_not_well_inside_the_arena_is_in_a_wall(x, y, margin):
    walls = Obstacles.of([], float(margin), ARENA)
    inside = min(x - ARENA.left, ARENA.right - x, y - ARENA.bottom, ARENA.top - y) > margin
    assert walls.contain(*at(x, y))[0] == (not inside)


@given(COORDINATES, COORDINATES, COORDINATES, COORDINATES)
def test_a_way_crosses_a_wall_where_one_of_its_ends_does(x0, y0, x1, y1):
    walls = Obstacles.of([], 0.0, ARENA)
    ends = walls.contain(*at(x0, y0)) | walls.contain(*at(x1, y1))
    assert walls.cross(*at(x0, y0, x1, y1)) == ends


@given(st.floats(-4, 4), st.floats(-5, 5), *(st.floats(-9, 9) for _ in range(4)))
def test_the_compiled_side_agrees(angle, offset, x0, y0, x1, y1):
    shape = HalfPlane((math.cos(angle), math.sin(angle)), offset)
    row, pack = shape.row(), PackedHalfPlanes
    distance = float(shape.distance(*at(x0, y0))[0])
    assert pack.gap(x0, y0, row) == pytest.approx(distance, abs=1e-12)
    assert pack.depth(x0, y0, row) == pytest.approx(-distance, abs=1e-12)
    assert pack.gap_between(x0, y0, x1, y1, row) == pytest.approx(
        min(distance, float(shape.distance(*at(x1, y1))[0])), abs=1e-12
    )
    east, north = pack.outward(x0, y0, row)
    outside = shape.distance(*at(x0 + east, y0 + north))
    assert outside[0] == pytest.approx(distance + 1, abs=1e-12)
    assert shape.grown(0.5).distance(*at(x0, y0))[0] == pytest.approx(distance - 0.5, abs=1e-12)


def test_nobody_draws_a_wall():
    assert HalfPlane((1.0, 0.0), 0.0).outline().shape == (0, 2)
