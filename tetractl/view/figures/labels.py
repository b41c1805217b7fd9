"""Places text next to trails and curves, away from other marks."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

from tetractl.core.poses import Floats
from tetractl.core.setup import Bounds
from tetractl.view import style

HALO = [withStroke(linewidth=1.6, foreground="white")]


def separated(wanted: Floats, gap: float) -> Floats:
    """Return increasing heights from 0 to 1, at least `gap` apart, near the increasing heights
    `wanted`.

    Neighbours that would overlap form a block around the mean of their heights, the least-squares
    solution. Then all heights are shifted into the range, as far as they fit.
    """
    blocks: list[tuple[float, int]] = []  # mean of wanted - index * gap, and the number of heights
    for i, height in enumerate(wanted):
        mean, count = float(height) - i * gap, 1
        while blocks and blocks[-1][0] > mean:
            before, many = blocks.pop()
            mean, count = (mean * count + before * many) / (count + many), count + many
        blocks.append((mean, count))
    base = np.repeat([mean for mean, _ in blocks], [count for _, count in blocks])
    rise = gap * np.arange(len(wanted))
    highest = max(1.0 - gap * (len(wanted) - 1), 0.0)
    return np.asarray(np.clip(base, 0.0, highest) + rise, dtype=np.float64)


def edge(arena: Bounds) -> Floats:
    """Return points along the edge of the arena, shape (M, 2)."""
    x = np.linspace(arena.left, arena.right, 60)
    y = np.linspace(arena.bottom, arena.top, 60)
    rows = [np.column_stack([x, np.full(60, end)]) for end in (y[0], y[-1])]
    columns = [np.column_stack([np.full(60, end), y]) for end in (x[0], x[-1])]
    return np.concatenate([*rows, *columns])


class Labels:
    """Writes times next to the trails, each where it is farthest from other marks."""

    def __init__(self, axes: Axes, trails: Floats, point: float) -> None:
        """Place labels away from `trails` (M, 2); `point` is the number of length units that 1/72
        inch of the figure shows.
        """
        self._axes, self._point = axes, point
        self._taken = trails[np.isfinite(trails).all(axis=1)]

    def write(self, xy: Floats, tip: Floats, text: str) -> None:
        """Write text next to a tick, which is drawn from `xy` to `tip`."""
        self._taken = np.concatenate([self._taken, [tip, (xy + tip) / 2]])
        angles = np.arange(0, 2 * np.pi, np.pi / 6)
        aside = np.column_stack([9 * np.cos(angles), 6.5 * np.sin(angles)])
        spots = xy + aside * self._point
        gaps = spots[:, None] - self._taken
        gaps[..., 1] *= 1.5  # a label is wider than high
        best = int(np.linalg.norm(gaps, axis=-1).min(axis=1, initial=np.inf).argmax())
        width = np.linspace(-4, 4, 5) * self._point
        label = np.column_stack([spots[best, 0] + width, np.full(5, spots[best, 1])])
        self._taken = np.concatenate([self._taken, label])
        self._axes.annotate(
            text, (float(xy[0]), float(xy[1])), tuple(aside[best]), textcoords="offset points",
            ha="center", va="center", fontsize=5.5, color=style.INK, path_effects=HALO, zorder=5,
        )  # fmt: skip
