"""Tests of the arena in characters: where robots are drawn, and signs for angles and numbers."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.style import Style
from testkit.trials import experiment, three_robots

from tetractl.core.setup import Bounds
from tetractl.model.shapes import Rectangle
from tetractl.view.player import Moment, Recording
from tetractl.view.terminal.arena import (
    DOT_COLUMNS,
    DOT_ROWS,
    Canvas,
    Projection,
    _sample_filling,
    draw_moment,
)
from tetractl.view.terminal.glyphs import choose_arrow, draw_sparkline

pytestmark = pytest.mark.slow

COLORS = ["#009E73", "#0072B2", "#D55E00"]
lengths = st.floats(1e-3, 1e5)


def arena_of(x, y, width, height):
    """An arena by its lower left corner and its size."""
    return Bounds(x, y, x + width, y + height)


arenas = st.builds(
    arena_of,
    st.floats(-1e4, 1e4),
    st.floats(-1e4, 1e4),
    lengths,
    lengths,
)
sizes = st.integers(1, 300)
shares = st.floats(0, 1)


@given(arenas, sizes, sizes, shares, shares)
def test_any_position_in_the_arena_lands_on_the_canvas(arena, width, height, fx, fy):
    view = Projection.fit(arena, width, height)
    assert 1 <= view.width <= width
    assert 1 <= view.height <= height
    x = arena.left + fx * arena.width
    y = arena.bottom + fy * arena.height
    (column,), (row,) = view.to_dots(np.array([[x, y]]))
    assert 0 <= column < DOT_COLUMNS * view.width
    assert 0 <= row < DOT_ROWS * view.height


@given(arenas, sizes, sizes, shares, shares, shares, shares)
def test_right_is_right_and_up_is_up(arena, width, height, ax, ay, bx, by):
    view = Projection.fit(arena, width, height)
    share = np.array([[ax, ay], [bx, by]])
    (ca, cb), (ra, rb) = view.to_dots(
        [arena.left, arena.bottom] + share * [arena.width, arena.height]
    )
    assert ca <= cb if ax <= bx else ca >= cb
    assert ra >= rb if ay <= by else ra <= rb


@given(
    st.tuples(*[st.floats(allow_nan=True, allow_infinity=True)] * 3),
    sizes.filter(lambda n: n < 60),
    sizes.filter(lambda n: n < 40),
)
def test_any_pose_whatever_can_be_drawn(pose, width, height):
    spec = experiment()
    frame = Moment(
        spec.setup,
        0.0,
        None,
        np.array([pose] * 3),
        np.array([[pose[:2]] * 3]),
        None,
        np.array([]),
        0,
        None,
    )
    canvas = draw_moment(frame, COLORS, width, height)
    text = canvas.render_text()
    assert len(text) <= height
    assert {len(line) for line in text} == {canvas.width}


def test_the_robots_stand_where_they_are_and_look_where_they_head():
    recording = Recording(three_robots())
    frame = recording.moment_at(3_000_000_000)
    canvas = draw_moment(frame, COLORS, 60, 30)
    view = Projection.fit(frame.setup.arena, 60, 30)
    text = canvas.render_text()
    for robot in range(3):
        x, y, heading = frame.poses[robot]
        column, row = view.to_cell(x, y)
        assert text[row][column] == choose_arrow(heading)
        column, row = view.to_cell(*frame.setup.targets[robot])
        assert text[row][column] == "□"
    assert [row for row in range(len(text)) if "⣿" in text[row]]


def test_a_canvas_keeps_the_last_style_of_a_cell_and_cuts_where_it_changes():
    canvas = Canvas(3, 1)
    red = Style(color="red")
    blue = Style(color="blue")
    canvas.draw_dots(np.array([0, 2, 4]), np.array([0, 0, 0]), red)
    canvas.put_character(1, 0, "x", blue)
    canvas.put_character(9, 9, "y", blue)
    (row,) = canvas.render_segments()
    assert [(segment.text, segment.style) for segment in row] == [
        ("⠁", red),
        ("x", blue),
        ("⠁", red),
    ]


@pytest.mark.parametrize(
    ("degrees", "sign"), [(0, "→"), (44, "↗"), (90, "↑"), (179, "←"), (-91, "↓"), (700, "→")]
)
def test_arrows_point_along_angles(degrees, sign):
    assert choose_arrow(math.radians(degrees)) == sign


def test_a_sparkline_scales_from_zero_and_leaves_the_rest_open():
    line = draw_sparkline([8, 4, 0], 6, total=6)
    assert line.plain == "█▅▁···"
    assert draw_sparkline([100, 10, 1], 3, log=True).plain == "█▅▁"
    assert draw_sparkline([], 4).plain == "····"


@pytest.mark.parametrize(
    "arena",
    [
        arena_of(0, 0, 1000, 1000),
        arena_of(-900, 0, 500, 2000),
        arena_of(5000, -300, 1600, 700),
        arena_of(-3, -8, 2, 1),
        arena_of(-4e3, 6e3, 3e3, 2e3),
    ],
)
@given(shares, shares, st.floats(0.1, 1), st.floats(0.1, 1))
def test_an_obstacle_fills_its_part_of_the_arena(arena, x, y, wide, high):
    """Each dot whose middle is inside of both, wherever the arena lies; part may be outside."""
    view = Projection.fit(arena, 40, 20)
    rectangle = Rectangle(
        type="rectangle",
        left=arena.left + (1.4 * x - 0.4) * arena.width,
        bottom=arena.bottom + (1.4 * y - 0.4) * arena.height,
        width=wide * arena.width,
        height=high * arena.height,
    )
    columns, rows = view.to_dots(_sample_filling(rectangle.shape(), view))
    drawn = set(zip(columns.tolist(), rows.tolist(), strict=True))
    margin = 0.6 * view.dot_width
    centres_x = np.arange(arena.left, arena.right, view.dot_width)
    centres_y = np.arange(arena.top, arena.bottom, -view.dot_width)
    in_x = np.abs(centres_x - rectangle.left - rectangle.width / 2) < rectangle.width / 2 - margin
    in_y = np.abs(centres_y - rectangle.bottom - rectangle.height / 2) < (
        rectangle.height / 2 - margin
    )
    inner = {(c, r) for c in np.flatnonzero(in_x).tolist() for r in np.flatnonzero(in_y).tolist()}
    assert inner <= drawn
