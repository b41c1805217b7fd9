"""The distribution of total errors as inline SVG: a dot a trial, each a link to its trial."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from tetractl.stats.summary import Summary
from tetractl.stats.text import lengths

WIDTH, LEFT, RIGHT, ROW, TOP, DOT = 860, 190, 20, 66, 8, 4.5
WIDE_RATIO = 30.0
"""Largest over least error above which the axis is logarithmic."""


@dataclass(frozen=True, slots=True)
class Row:
    """The errors of one batch: `errors` with the number of each trial on the page, from 1."""

    name: str
    errors: Sequence[tuple[float, int]]
    summary: Summary


def errors_svg(rows: Sequence[Row]) -> str:
    """Return the picture, "" where no trial counts.

    Each batch has a row with its mean and 95 % interval below the dots; a published result has one
    with its mean and standard deviation.
    """
    rows = [row for row in rows if row.errors]
    if not rows:
        return ""
    published = rows[0].summary.published
    values = [error for row in rows for error, _ in row.errors]
    if published:
        values += [published.reference.mean, published.reference.mean + published.reference.std]
    axis = _Axis(values)
    unit = rows[0].summary.unit.replace("um", "µm")
    parts, y = [], float(TOP)
    for row in rows:
        parts.append(_batch(row, axis, y))
        y += ROW
    if published:
        known = published.reference
        low, high = axis(max(known.mean - known.std, axis.low)), axis(known.mean + known.std)
        parts.append(
            _name(y, "published", f"n {known.n}, mean ± sd") + f'<path d="M{low:.1f} {y + 26:.1f}'
            f'H{high:.1f}" stroke="var(--quiet)" stroke-width="3"/>'
            f'<circle cx="{axis(known.mean):.1f}" cy="{y + 26:.1f}" r="5"'
            f' style="fill:var(--quiet);fill-opacity:1"><title>published: {known.mean:g} ±'
            f" {known.std:g} {unit}</title></circle>"
        )
        y += ROW
    grid = "".join(
        f'<path d="M{axis(at):.1f} {TOP}V{y:.1f}" stroke="var(--grid)"/>'
        f'<text x="{axis(at):.1f}" y="{y + 16:.1f}" text-anchor="middle">{at:g}</text>'
        for at in axis.ticks
    )
    label = f"total error [{unit}]" + (", logarithmic" if axis.log else "")
    return (
        f'<div class="scroll"><svg class="errors" viewBox="0 0 {WIDTH} {y + 40:.0f}" role="img"'
        f' aria-label="Total error of every trial">{grid}{"".join(parts)}'
        f'<text x="{WIDTH - RIGHT}" y="{y + 34:.1f}" text-anchor="end">{label}</text></svg></div>'
    )


class _Axis:
    """Maps an error to its place [px]; logarithmic where the errors span a wide range."""

    def __init__(self, values: Sequence[float]) -> None:
        positive = [value for value in values if value > 0]
        most = max(positive, default=1.0)
        self.log = bool(positive) and most / min(positive) > WIDE_RATIO
        if self.log:
            self.low = 10.0 ** math.floor(math.log10(min(positive)))
            self.high = 10.0 ** math.ceil(math.log10(most) + 1e-9)
            first, last = round(math.log10(self.low)), round(math.log10(self.high))
            self.ticks = [10.0**power for power in range(first, last + 1)]
        else:
            step = 10.0 ** math.floor(math.log10(most))
            step *= next(m for m in (0.2, 0.5, 1, 2) if most / (step * m) <= 7)
            self.low, self.high = 0.0, step * math.ceil(most * 1.02 / step)
            self.ticks = [k * step for k in range(round(self.high / step) + 1)]

    def __call__(self, value: float) -> float:
        low, high = self.low, self.high
        value = min(max(value, low), high)
        if self.log:
            share = (math.log(value) - math.log(low)) / (math.log(high) - math.log(low))
        else:
            share = (value - low) / (high - low)
        return LEFT + share * (WIDTH - LEFT - RIGHT)


def _batch(row: Row, axis: _Axis, y: float) -> str:
    show = lengths(row.summary.total.mean)
    placed: list[tuple[float, int]] = []
    dots = []
    for error, trial in sorted(row.errors):
        x = axis(error)
        taken = {level for other, level in placed if abs(other - x) < 2 * DOT}
        level = next(k for k in range(len(placed) + 1) if k not in taken)
        placed.append((x, level))
        up = y + 30 - min(level * 1.6 * DOT, 26)
        dots.append(
            f'<a href="#trial-{trial}"><circle cx="{x:.1f}" cy="{up:.1f}" r="{DOT}">'
            f"<title>trial {trial}: {show(error)}</title></circle></a>"
        )
    total, mean = row.summary.total, axis(row.summary.total.mean)
    ends = total.ci95.ends
    bar = ""
    if ends:
        bar = f'<path d="M{axis(ends[0]):.1f} {y + 44:.1f}H{axis(ends[1]):.1f}"'
        bar += ' stroke="var(--ink)" stroke-width="3"/>'
    bar += f'<path d="M{mean:.1f} {y + 38:.1f}v12" stroke="var(--ink)" stroke-width="2"/>'
    return _name(y, row.name, f"n {total.n}, mean, 95 % interval") + "".join(dots) + bar


def _name(y: float, name: str, note: str) -> str:
    return (
        f'<text class="name" x="0" y="{y + 22:.1f}">{escape(name)}</text>'
        f'<text x="0" y="{y + 40:.1f}">{escape(note)}</text>'
    )
