"""One figure a swept field: total error against the field's value, a line a controller."""

import math
import re
from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tetractl.core.colors import PALETTE
from tetractl.study.cells import shown
from tetractl.study.effect import Group, groups, numeric
from tetractl.study.load import LoadedStudy
from tetractl.study.store import Store
from tetractl.study.table import counted_rows
from tetractl.view import style

DECADES = 2  # that positive values must span to be drawn on a logarithmic axis
LABEL = 24  # characters of a value that is no number


def write_figures(loaded: LoadedStudy, store: Store) -> list[Path]:
    """Write error-FIELD.png for every swept field; the same rows give the same bytes."""
    paths = []
    for field in loaded.paths:
        drawing = error_figure(loaded, store, field)
        if drawing is not None:
            name = re.sub(r"[^A-Za-z0-9._+-]+", "_", field)
            paths.append(store.folder / f"error-{name}.png")
            style.save(drawing, paths[-1])
    return paths


def error_figure(loaded: LoadedStudy, store: Store, field: str) -> Figure | None:
    """Draw the mean total error with its 95 % interval against a field; None without any error.

    Where several arms share a value, the mean is over them too, world by world.
    """
    names = dict.fromkeys(arm.controller for arm in loaded.arms)
    curves = {
        name: [
            group
            for group in groups(
                loaded, store, field, (arm for arm in loaded.arms if arm.controller == name)
            )
            if group.error.n > 0
        ]
        for name in names
    }
    every = [group for found in curves.values() for group in found]
    if not every:
        return None
    with style.styled():
        figure = style.figure(style.PAGE_IN, 2.8)
        axes = figure.subplots()
        places = _places(axes, every)
        for number, (name, found) in enumerate(curves.items()):
            aside = (number - (len(curves) - 1) / 2) * 0.12 if not numeric(every) else 0.0
            x = [places[shown(group.value)] + aside for group in found]
            joined = numeric(every) and _alike(found, len(loaded.paths))
            _draw(axes, x, found, PALETTE[number % len(PALETTE)], name, joined)
        axes.set_xlabel(field)
        axes.set_ylabel(f"total error [{style.unit_of(loaded.unit)}]")
        axes.set_ylim(bottom=0)
        axes.grid(axis="y", color=style.FAINT, linewidth=0.6)
        axes.set_axisbelow(True)
        if any(names):
            figure.legend(loc="outside lower center", ncols=4)
    style.headline(figure, _headline(loaded, store, every))
    return figure


def _places(axes: Axes, found: Sequence[Group]) -> dict[str, float]:
    """Return the place of each value on the x axis, which is labelled to fit."""
    if not numeric(found):
        labels = list(dict.fromkeys(shown(group.value) for group in found))
        axes.set_xticks(range(len(labels)), [label[:LABEL] for label in labels])
        axes.set_xlim(-0.5, len(labels) - 0.5)
        return {label: float(place) for place, label in enumerate(labels)}
    values = [float(group.value) for group in found]
    if min(values) > 0 and max(values) / min(values) >= 10**DECADES:
        axes.set_xscale("log")
    return {shown(group.value): float(group.value) for group in found}


def _alike(found: Sequence[Group], fields: int) -> bool:
    """Whether neighbouring values differ in the field alone, so that a line may join them."""
    return len({group.arms for group in found}) == 1 and (fields == 1 or found[0].arms > 1)


def _draw(
    axes: Axes, x: list[float], found: Sequence[Group], color: str, name: str, joined: bool
) -> None:
    means = [group.error.mean for group in found]
    axes.plot(
        x,
        means,
        "-o" if joined else "o",
        color=color,
        markersize=3.5,
        label=name or None,
        clip_on=False,
        zorder=3,
    )
    known = [(place, g.error.ci95) for place, g in zip(x, found, strict=True) if g.error.ci95.known]
    axes.vlines(
        [place for place, _ in known],
        [interval.low for _, interval in known],
        [interval.high for _, interval in known],
        color=color,
        linewidth=2.5,
        alpha=0.45,
    )


def _headline(loaded: LoadedStudy, store: Store, found: Sequence[Group]) -> str:
    """Return what was steered, how often, and what is drawn."""
    origins = sorted({row.columns["origin"] for _, row in counted_rows(loaded, store)})
    counts = sorted({group.error.n for group in found})
    n = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    pooled = "" if math.prod(group.arms for group in found) == 1 else ", over the other fields"
    return f"{loaded.study.name}, {' and '.join(origins)}: mean{pooled}, 95 % interval, n = {n}"
