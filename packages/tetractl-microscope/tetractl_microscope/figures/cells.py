"""Draws the figure of a film's cells: their paths over the first picture, and next to it speeds
and turning in the field, as far as the film has them.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from tetractl.core.colors import PALETTE
from tetractl.core.poses import Floats, Grey
from tetractl.results.estimate import Distribution, Interval, known_distribution
from tetractl.view import style
from tetractl_microscope.results.cell_tables import cell_mean, known_values

BAR_SHARE = 0.25  # longest scale bar, as a share of the picture's width
CELLS_MIN = 5  # least number of cells for an interval of their mean
NUMBERED = 60  # most cells that are numbered
TURN_S = 0.2  # time over which the rate of turning is computed [s]
BINS = 12  # bins of the angle to the field
BIN_MIN = 3  # least number of values in a bin
LEAST_IN = 2.2  # least height of a panel next to the paths [in]


@dataclass(frozen=True, slots=True)
class FilmTracks:
    """What `tetractl track` found in a film: the `record` that it prints with --json; number, times
    (K,) [s], and x, y [um] and heading [rad] (K, 3) of each cell that has two or more; and the
    film's first `picture`.
    """

    record: dict[str, Any]
    paths: Sequence[tuple[int, Floats, Floats]]
    picture: Grey


@style.styled()
def cells_figure(film: FilmTracks) -> Figure:
    """Draw the paths and, if they are known, the cells' speeds and how they turn in the field."""
    record = film.record
    panels: dict[str, tuple[str, Callable[[Axes, FilmTracks], None]]] = {
        "paths": ("paths over the first picture", _paths)
    }
    if known_values(record["cells"], "speed_um_s")[1]:
        panels["speeds"] = ("speed", _speeds)
    if record["field"] and film.paths:
        panels["turning"] = ("turning", _turning)
    rows: list[Any] = [["paths", "paths", name] for name in panels if name != "paths"]
    shape = record["height"] / record["width"]
    height_in = max(min(2 / 3 * style.PAGE_IN * shape, 5.2) + 0.6, LEAST_IN * len(rows))
    figure = style.figure(style.PAGE_IN, height_in)
    mosaic = figure.subplot_mosaic(rows or [["paths"]])
    for letter, (name, axes) in zip("abc", mosaic.items(), strict=False):
        title, draw = panels[name]
        draw(axes, film)
        axes.set_title(f"({letter}) {title}", loc="left")
    seconds = record["pictures"] / record["rate_hz"]
    style.headline(
        figure,
        f"{record['film']}: {len(record['cells'])} tracks, {seconds:.3g} s, "
        f"{record['um_per_px']:.3g} µm/px",
    )
    return figure


def _color(number: int) -> str:
    return PALETTE[number % len(PALETTE)]


def _paths(axes: Axes, film: FilmTracks) -> None:
    """Draw each cell's path over the film's first picture, its number at the end."""
    um_px = film.record["um_per_px"]
    width, height = (film.record[side] * um_px for side in ("width", "height"))
    low, high = np.percentile(film.picture, (0.5, 99.5))
    span = {"extent": (0, width, 0, height), "vmin": low - 5, "vmax": high + 5}
    axes.imshow(film.picture, cmap="gray", interpolation="antialiased", **span)
    edge = [withStroke(linewidth=1.8, foreground="white", alpha=0.8)]
    for number, _, poses in film.paths:
        axes.plot(*poses[:, :2].T, color=_color(number), lw=1.1, path_effects=edge)
        axes.plot(*poses[-1, :2], "o", ms=2.5, color=_color(number), mec="white", mew=0.4)
        if len(film.record["cells"]) <= NUMBERED:
            x, y = poses[-1, :2].tolist()
            position = sorted((0, x, 0.96 * width))[1], sorted((0, y, 0.96 * height))[1]
            look = {"color": _color(number), "weight": "bold", "path_effects": edge}
            axes.annotate(
                str(number), position, (3, 3), textcoords="offset points", fontsize=7, **look
            )
    power = 10.0 ** math.floor(math.log10(BAR_SHARE * width))
    bar = max(step * power for step in (1, 2, 5) if step * power <= BAR_SHARE * width)
    x = 0.97 * width - bar
    y = 0.04 * height
    look: dict[str, Any] = {
        "color": "white",
        "path_effects": [withStroke(linewidth=4.5, foreground="black")],
    }
    axes.plot([x, x + bar], [y, y], lw=3, solid_capstyle="butt", **look)
    look["path_effects"] = [withStroke(linewidth=2, foreground="black")]
    label = f"{bar / 1000:g} mm" if bar >= 1000 else f"{bar:g} µm"
    axes.text(x + bar / 2, y + 0.012 * height, label, ha="center", va="bottom", **look)
    axes.set(xlim=(0, width), ylim=(0, height), xticks=[], yticks=[])


def _speeds(axes: Axes, film: FilmTracks) -> None:
    """Draw each cell's speed in order, with its 95 % interval if it has one, and their mean."""
    cells, speeds = known_values(film.record["cells"], "speed_um_s")
    order = np.argsort(speeds, kind="stable").tolist()
    cells = [cells[k] for k in order]
    rows = range(len(cells))
    colors = [_color(cell["cell"]) for cell in cells]
    for row, (cell, color) in enumerate(zip(cells, colors, strict=True)):
        if isinstance(cell["speed_um_s"], dict):
            axes.hlines(row, *cell["speed_um_s"]["ci95"], color=color, lw=1.4)
    axes.scatter([speeds[k] for k in order], rows, s=9, color=colors)
    few = len(cells) <= NUMBERED / 2
    labels = [f"{cell['cell']}{'      ' * (row % 2)}" for row, cell in enumerate(cells)]
    axes.set_yticks(range(len(cells)) if few else [], labels * few)
    axes.tick_params(axis="y", length=0, labelsize=5.5)
    mean = _mean(cells, sorted(speeds))
    axes.axvline(mean.mean, color=style.GREY, lw=0.8, ls="--", zorder=0)
    if mean.ci95.known:
        axes.axvspan(mean.ci95.low, mean.ci95.high, color=style.FAINT, lw=0, zorder=0)
    axes.set(xlabel=f"speed [µm/s]\nmean {_stated(mean)}", ylabel="cell")


def _mean(cells: Sequence[Any], values: Sequence[float]) -> Distribution:
    """Return the mean with its interval; without one for fewer than CELLS_MIN cells."""
    few = Interval.none(f"fewer than {CELLS_MIN} cells")
    if not cells:
        return known_distribution(0, math.nan, math.nan, few)
    mean = cell_mean(cells, values)
    return mean if mean.n >= CELLS_MIN else replace(mean, ci95=few)


def _means(cells: Sequence[Any], rows: list[Any]) -> tuple[list[Distribution], Floats]:
    """Return the mean over the cells' `rows` (C, K) at each place, and the ends (2, K) of the
    intervals; NaN is unknown.
    """
    means = []
    for column in np.array(rows, dtype=float).T:
        is_known = np.isfinite(column)
        cells_known = list(compress(cells, is_known))
        means.append(_mean(cells_known, column[is_known].tolist()))
    return means, np.array([(mean.ci95.low, mean.ci95.high) for mean in means]).T


def _stated(mean: Distribution, decimals: int = 0) -> str:
    """Return a mean with its interval and n, as text."""
    ends = mean.ci95
    text = f"{mean.mean:.{decimals}f}"
    if ends.known:
        text += f" [{ends.low:.{decimals}f}, {ends.high:.{decimals}f}]"
    return f"{text}, n = {mean.n}"


def _turning(axes: Axes, film: FilmTracks) -> None:
    """Draw each cell's rate of turning against the angle from its heading to the field, a dot for
    each bin; the mean over the cells that respond; and a sin(angle) with the mean of their a.
    """
    edges = np.linspace(-math.pi, math.pi, BINS + 1)
    middle = (edges[:-1] + edges[1:]) / 2
    rates = []
    cells, values = known_values(film.record["cells"], "a_rad_s")
    responds = [cell["cell"] for cell in cells]
    for number, times, poses in film.paths:
        angle, rate = turns(times, poses[:, 2], film.record["field"])
        binned = np.digitize(angle, edges) - 1
        counts = np.bincount(binned, minlength=BINS)[:BINS]
        sums = np.bincount(binned, rate, minlength=BINS)[:BINS]
        row = np.where(counts >= BIN_MIN, sums / np.maximum(counts, 1), np.nan)
        color = _color(number) if number in responds else style.FAINT
        axes.plot(middle, row, "o", ms=1.8, alpha=0.7, mew=0, color=color)
        if number in responds:
            rates.append(row)
    if not rates:
        return
    means, ends = _means(cells, rates)
    axes.vlines(middle, *ends, color=style.INK, lw=1, zorder=2)
    axes.plot(middle, [mean.mean for mean in means], "s", ms=3, color=style.INK)
    overall = _mean(cells, values)
    curve = np.linspace(-math.pi, math.pi, 100)
    axes.plot(curve, overall.mean * np.sin(curve), color=style.INK, lw=1, label="a sin(angle)")
    axes.set_xticks([-math.pi, 0, math.pi], ["-π", "0", "π"])
    axes.set(
        xlabel=f"angle to the field [rad]\na = {_stated(overall, 2)} cells",
        ylabel="rate of turning [rad/s]",
    )
    axes.legend(loc="upper left")


def turns(times: Floats, heading: Floats, field: dict) -> tuple[Floats, Floats]:
    """Return angles from the heading to the field [rad] and rates of turning [rad/s], the latter
    divided by the field's strength; over each TURN_S in which the field was constant and not 0.
    """
    since, x, y = (np.array(field[key]) for key in ("time_s", "x", "y"))
    heading = np.unwrap(heading)
    step = float(np.median(np.diff(times)))
    span = max(1, round(TURN_S / step))
    first = np.arange(len(times) - span)
    last = np.arange(span, len(times))
    row = np.searchsorted(since, times, side="right") - 1
    strength = np.hypot(x, y)[row]
    is_steady = (row[first] == row[last]) & (row[first] >= 0) & (strength[first] > 0)
    first = first[is_steady]
    last = last[is_steady]
    rate = (heading[last] - heading[first]) / (times[last] - times[first]) / strength[first]
    angle = np.arctan2(y, x)[row[first]] - (heading[first] + heading[last]) / 2
    return (angle + math.pi) % (2 * math.pi) - math.pi, rate
