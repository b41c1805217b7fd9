"""Draws the arena in a terminal: a canvas of braille dots, to scale, with robots as arrows."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from rich.segment import Segment
from rich.style import Style

from tetractl.core.colors import OBSTACLE_EDGE
from tetractl.core.poses import Floats
from tetractl.core.setup import Bounds
from tetractl.core.shape import Shape
from tetractl.view.player import Moment, find_first_positions
from tetractl.view.terminal.glyphs import choose_arrow

DOT_ROWS = 4
DOT_COLUMNS = 2
"""Number of columns of dots in a braille cell. DOT_ROWS is the number of its rows.

A cell is twice as high as wide, so the dots lie on a square grid.
"""
_DOT_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]], dtype=np.uint8)
"""The bit of each dot in the number of a braille character, shape (DOT_ROWS, DOT_COLUMNS)."""
BRAILLE = 0x2800
"""Unicode number of the braille character without dots, to which the bits of dots are added."""
DOT_INDEX_MAX = 1e6
"""Maximum column and row of a dot. It is far outside every terminal, and fits into an integer."""
_PLAIN = Style()
START = "○"
TARGET = "□"
OBSTACLE_STYLE = Style(color=OBSTACLE_EDGE)
BORDER_STYLE = Style(dim=True)


@dataclass(frozen=True, slots=True)
class Projection:
    """The scale by which the arena is drawn on a canvas of `width` x `height` character cells.

    A dot of the canvas is `dot_width` length units wide.
    """

    arena: Bounds
    width: int
    height: int
    dot_width: float

    @classmethod
    def fit(cls, arena: Bounds, width: int, height: int) -> "Projection":
        """Create the projection that shows the arena as large as the terminal allows.

        Args:
            arena: The arena.
            width: Number of columns.
            height: Number of rows.
        """
        columns_most = DOT_COLUMNS * max(width, 1)
        rows_most = DOT_ROWS * max(height, 1)
        scale = max(arena.width / (columns_most - 1), arena.height / (rows_most - 1))
        columns = round(arena.width / scale) + 1
        rows = round(arena.height / scale) + 1
        return cls(arena, math.ceil(columns / DOT_COLUMNS), math.ceil(rows / DOT_ROWS), scale)

    def to_dots(self, xy: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Convert positions (..., 2) in the arena to columns and rows of dots of the canvas.

        Columns and rows count from (0, 0) at the top left. Positions with NaN are left out. A
        position outside the arena may give a dot outside the canvas.
        """
        xy = xy[np.isfinite(xy).all(axis=-1)]
        column = np.rint((xy[:, 0] - self.arena.left) / self.dot_width)
        row = np.rint((self.arena.bottom + self.arena.height - xy[:, 1]) / self.dot_width)
        return (
            np.clip(column, -DOT_INDEX_MAX, DOT_INDEX_MAX).astype(np.int64),
            np.clip(row, -DOT_INDEX_MAX, DOT_INDEX_MAX).astype(np.int64),
        )

    def to_cell(self, x: float, y: float) -> tuple[int, int]:
        """Convert a position in the arena to the column and row of the nearest character cell.

        The result for an unknown position (NaN) is the lower left cell.
        """
        position = np.array([[x, y]])
        if not np.isfinite(position).all():
            position = np.array([[self.arena.left, self.arena.bottom]])
        columns, rows = self.to_dots(position)
        column = int(columns[0]) // DOT_COLUMNS
        row = int(rows[0]) // DOT_ROWS
        nearest_column = min(max(column, 0), self.width - 1)
        nearest_row = min(max(row, 0), self.height - 1)
        return nearest_column, nearest_row


class Canvas:
    """A canvas of character cells, each with 2 x 4 braille dots in the style of the newest dot."""

    def __init__(self, width: int, height: int) -> None:
        self.width = width
        self.height = height
        self._bits = np.zeros((height, width), dtype=np.uint8)
        self._styles: list[Style] = [_PLAIN]
        self._style = np.zeros((height, width), dtype=np.intp)
        self._chars = np.full((height, width), " ")

    def draw_dots(self, columns: NDArray[np.int64], rows: NDArray[np.int64], style: Style) -> None:
        """Draw dots in a style. Dots outside the canvas are left out.

        Args:
            columns: Column of each dot from the left. A character has DOT_COLUMNS columns.
            rows: Row of each dot from the top. A character has DOT_ROWS rows.
            style: Style of the dots. A character takes the style of its newest dot as a whole.
        """
        is_inside = (columns >= 0) & (columns < DOT_COLUMNS * self.width)
        is_inside &= (rows >= 0) & (rows < DOT_ROWS * self.height)
        columns = columns[is_inside]
        rows = rows[is_inside]
        cells = (rows // DOT_ROWS, columns // DOT_COLUMNS)
        np.bitwise_or.at(self._bits, cells, _DOT_BITS[rows % DOT_ROWS, columns % DOT_COLUMNS])
        self._style[cells] = self._index(style)

    def put_character(self, column: int, row: int, char: str, style: Style) -> None:
        """Replace the dots of a cell by a character. Outside the canvas, nothing is drawn.

        Args:
            column: Column of the cell.
            row: Row of the cell.
            char: The character.
            style: Its style.
        """
        if 0 <= column < self.width and 0 <= row < self.height:
            self._bits[row, column] = 0
            self._chars[row, column] = char
            self._style[row, column] = self._index(style)

    def render_text(self) -> list[str]:
        """Render the rows of the canvas as text, from top to bottom.

        In a cell with dots, the dots hide any character.
        """
        braille = (BRAILLE + self._bits.astype(np.uint32)).view("<U1")
        chars = np.where(self._bits > 0, braille, self._chars)
        return ["".join(row) for row in chars]

    def render_segments(self) -> list[list[Segment]]:
        """Render the rows of the canvas, each split into segments of one style."""
        rows = []
        for row_text, styles in zip(self.render_text(), self._style, strict=True):
            boundaries = [0, *(np.flatnonzero(np.diff(styles)) + 1), self.width]
            rows.append(
                [
                    Segment(row_text[begin:end], self._styles[styles[begin]])
                    for begin, end in pairwise(boundaries)
                ]
            )
        return rows

    def _index(self, style: Style) -> int:
        if style not in self._styles:
            self._styles.append(style)
        return self._styles.index(style)


def draw_moment(frame: Moment, colors: list[str], width: int, height: int) -> Canvas:
    """Draw one instant of a trial on a canvas.

    It shows obstacles, the plan (dotted), trails, starts (circles), targets (squares) and robots
    (arrows).

    Args:
        frame: The instant.
        colors: The robots' colours.
        width: Maximum number of columns.
        height: Maximum number of rows.
    """
    setup = frame.setup
    projection = Projection.fit(setup.arena, width, height)
    canvas = Canvas(projection.width, projection.height)
    for obstacle in setup.obstacles:
        canvas.draw_dots(*projection.to_dots(_sample_filling(obstacle, projection)), OBSTACLE_STYLE)
    if frame.step is not None and frame.result is None:
        path = frame.step.plan.path
        for robot, color in enumerate(colors):
            plan_style = Style(color=color, dim=True)
            canvas.draw_dots(*projection.to_dots(path[:, robot, :2]), plan_style)
    for robot, color in enumerate(colors):
        canvas.draw_dots(*projection.to_dots(frame.trail[:, robot]), Style(color=color))
    starts = find_first_positions(frame.trail, setup.starts.xy)
    for robot, color in enumerate(colors):
        canvas.put_character(*projection.to_cell(*starts[robot]), START, Style(color=color))
        for target in setup.legs[:, robot]:
            canvas.put_character(*projection.to_cell(*target), TARGET, Style(color=color))
    for robot, color in enumerate(colors):
        x, y, heading = frame.poses[robot].tolist()
        canvas.put_character(
            *projection.to_cell(x, y), choose_arrow(heading), Style(color=color, bold=True)
        )
    return canvas


def add_frame(canvas: Canvas, label: str) -> Iterable[list[Segment]]:
    """Yield the rows of a canvas with a thin border.

    The label is in the middle of the lower edge. It is left out if it is too long.
    """
    padded_label = f" {label} "
    if len(padded_label) > canvas.width:
        padded_label = ""
    left_dashes = (canvas.width - len(padded_label)) // 2
    right_dashes = canvas.width - len(padded_label) - left_dashes
    yield [Segment(f"┌{'─' * canvas.width}┐", BORDER_STYLE)]
    for row in canvas.render_segments():
        yield [Segment("│", BORDER_STYLE), *row, Segment("│", BORDER_STYLE)]
    yield [Segment(f"└{'─' * left_dashes}{padded_label}{'─' * right_dashes}┘", BORDER_STYLE)]


def _sample_filling(shape: Shape, projection: Projection) -> Floats:
    """Sample points (M, 2) whose dots fill a shape [length unit].

    There is one point for each dot inside both the shape and the arena, and more along the whole
    outline of the shape. A shape smaller than a dot has only outline points.
    """
    arena = projection.arena
    outline = shape.outline()
    left, bottom = outline.min(axis=0)
    right, top = outline.max(axis=0)
    x = _space_evenly(max(left, arena.left), min(right, arena.right), projection.dot_width)
    y = _space_evenly(max(bottom, arena.bottom), min(top, arena.top), projection.dot_width)
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    is_inside = shape.contains(grid[:, 0], grid[:, 1])
    return np.vstack([grid[is_inside], outline])


def _space_evenly(lower: float, upper: float, step_max: float) -> Floats:
    """Compute evenly spaced coordinates from `lower` to `upper`, at most `step_max` apart.

    Both limits are included. The result is empty if `upper` is below `lower`.
    """
    if upper < lower:
        return np.empty(0)
    return np.linspace(lower, upper, math.ceil((upper - lower) / step_max) + 1)
