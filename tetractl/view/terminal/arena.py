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
from tetractl.view.player import Moment, first_seen
from tetractl.view.terminal.glyphs import arrow

DOWN = 4
ACROSS = 2
"""Number of columns of dots in a braille cell. DOWN is the number of rows.

A cell is twice as high as wide, so the dots lie on a square grid.
"""
_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]], dtype=np.uint8)
"""The bit of each dot of a cell (DOWN, ACROSS) in the number of its braille character."""
BRAILLE = 0x2800
"""The braille character without a dot in Unicode, from which the others count."""
DOT_MOST = 1e6
"""Maximum column and row of a dot, far outside of every terminal, so that numbers are integers."""
_PLAIN = Style()
START = "○"
TARGET = "□"
OBSTACLE_STYLE = Style(color=OBSTACLE_EDGE)
BORDER_STYLE = Style(dim=True)


@dataclass(frozen=True, slots=True)
class Projection:
    """The scale by which the arena is drawn on a canvas of `width` x `height` character cells.

    A dot of the canvas is `scale` length units wide.
    """

    arena: Bounds
    width: int
    height: int
    scale: float

    @classmethod
    def fit(cls, arena: Bounds, width: int, height: int) -> "Projection":
        """Create the projection that shows the arena as large as the terminal allows.

        Args:
            arena: The arena.
            width: Number of columns.
            height: Number of rows.
        """
        columns_most = ACROSS * max(width, 1)
        rows_most = DOWN * max(height, 1)
        scale = max(arena.width / (columns_most - 1), arena.height / (rows_most - 1))
        columns = round(arena.width / scale) + 1
        rows = round(arena.height / scale) + 1
        return cls(arena, math.ceil(columns / ACROSS), math.ceil(rows / DOWN), scale)

    def dots(self, xy: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the columns and rows of the canvas dots at positions (..., 2) of the arena.

        They count from (0, 0) at the top left. Positions with NaN are left out. A position outside
        the arena may give a dot outside the canvas.
        """
        xy = xy[np.isfinite(xy).all(axis=-1)]
        column = np.rint((xy[:, 0] - self.arena.left) / self.scale)
        row = np.rint((self.arena.bottom + self.arena.height - xy[:, 1]) / self.scale)
        return (
            np.clip(column, -DOT_MOST, DOT_MOST).astype(np.int64),
            np.clip(row, -DOT_MOST, DOT_MOST).astype(np.int64),
        )

    def cell(self, x: float, y: float) -> tuple[int, int]:
        """Return the column and row of the character cell at a position, or of the nearest cell.

        For an unknown position (NaN), it is the lower left cell.
        """
        position = np.array([[x, y]])
        if not np.isfinite(position).all():
            position = np.array([[self.arena.left, self.arena.bottom]])
        columns, rows = self.dots(position)
        column = int(columns[0]) // ACROSS
        row = int(rows[0]) // DOWN
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

    def dots(self, columns: NDArray[np.int64], rows: NDArray[np.int64], style: Style) -> None:
        """Draw dots in a style. Those outside the canvas are left out.

        Args:
            columns: Their columns in braille dots from the left, ACROSS for each character.
            rows: Their rows in braille dots from the top, DOWN for each character.
            style: Their style, which each character touched takes as a whole.
        """
        inside = (columns >= 0) & (columns < ACROSS * self.width)
        inside &= (rows >= 0) & (rows < DOWN * self.height)
        columns = columns[inside]
        rows = rows[inside]
        cells = (rows // DOWN, columns // ACROSS)
        np.bitwise_or.at(self._bits, cells, _BITS[rows % DOWN, columns % ACROSS])
        self._style[cells] = self._index(style)

    def put(self, column: int, row: int, char: str, style: Style) -> None:
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

    def text(self) -> list[str]:
        """Return the rows of the canvas as text, from top to bottom.

        In a cell with dots, the dots hide any character.
        """
        braille = (BRAILLE + self._bits.astype(np.uint32)).view("<U1")
        chars = np.where(self._bits > 0, braille, self._chars)
        return ["".join(row) for row in chars]

    def segments(self) -> list[list[Segment]]:
        """Return the rows of the canvas, each split into segments of one style."""
        rows = []
        for text, styles in zip(self.text(), self._style, strict=True):
            cuts = [0, *(np.flatnonzero(np.diff(styles)) + 1), self.width]
            rows.append([Segment(text[a:b], self._styles[styles[a]]) for a, b in pairwise(cuts)])
        return rows

    def _index(self, style: Style) -> int:
        if style not in self._styles:
            self._styles.append(style)
        return self._styles.index(style)


def draw(frame: Moment, colors: list[str], width: int, height: int) -> Canvas:
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
    view = Projection.fit(setup.arena, width, height)
    canvas = Canvas(view.width, view.height)
    for obstacle in setup.obstacles:
        canvas.dots(*view.dots(_filling(obstacle, view)), OBSTACLE_STYLE)
    if frame.step is not None and frame.result is None:
        plan = frame.step.plan.path
        for robot, color in enumerate(colors):
            dotted = Style(color=color, dim=True)
            canvas.dots(*view.dots(plan[:, robot, :2]), dotted)
    for robot, color in enumerate(colors):
        canvas.dots(*view.dots(frame.trail[:, robot]), Style(color=color))
    starts = first_seen(frame.trail, setup.starts.xy)
    for robot, color in enumerate(colors):
        canvas.put(*view.cell(*starts[robot]), START, Style(color=color))
        for target in setup.legs[:, robot]:
            canvas.put(*view.cell(*target), TARGET, Style(color=color))
    for robot, color in enumerate(colors):
        x, y, heading = frame.poses[robot].tolist()
        canvas.put(*view.cell(x, y), arrow(heading), Style(color=color, bold=True))
    return canvas


def framed(canvas: Canvas, label: str) -> Iterable[list[Segment]]:
    """Yield the rows of a canvas with a thin border.

    The label is in the middle of the lower edge. It is left out if it is too long.
    """
    words = f" {label} "
    if len(words) > canvas.width:
        words = ""
    before = (canvas.width - len(words)) // 2
    after = canvas.width - len(words) - before
    yield [Segment(f"┌{'─' * canvas.width}┐", BORDER_STYLE)]
    for row in canvas.segments():
        yield [Segment("│", BORDER_STYLE), *row, Segment("│", BORDER_STYLE)]
    yield [Segment(f"└{'─' * before}{words}{'─' * after}┘", BORDER_STYLE)]


def _filling(shape: Shape, view: Projection) -> Floats:
    """Return points (M, 2) whose dots fill a shape [length unit].

    There is one point for each dot inside both the shape and the arena, and more along the whole
    outline of the shape. A shape smaller than a dot has only outline points.
    """
    arena = view.arena
    outline = shape.outline()
    left, bottom = outline.min(axis=0)
    right, top = outline.max(axis=0)
    x = _ticks(max(left, arena.left), min(right, arena.right), view.scale)
    y = _ticks(max(bottom, arena.bottom), min(top, arena.top), view.scale)
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    inside = shape.contains(grid[:, 0], grid[:, 1])
    return np.vstack([grid[inside], outline])


def _ticks(low: float, high: float, step: float) -> Floats:
    """Return equally spaced coordinates from low to high, both included, at most `step` apart.

    The result is empty if high < low.
    """
    if high < low:
        return np.empty(0)
    return np.linspace(low, high, math.ceil((high - low) / step) + 1)
