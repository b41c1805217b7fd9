"""The figures of a study: total error by arm and, for each swept field, against its value, in the
colours of the controllers.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import ScaledTranslation

from tetractl.core.colors import PALETTE
from tetractl.core.errors import unit_of
from tetractl.study.arm_table import LISTED, FieldValue, error_of, field_values, numeric, origins
from tetractl.study.load_study import LoadedStudy, as_yaml, shown
from tetractl.study.row_store import Store
from tetractl.view import style

ARMS = "arms"  # in place of a field: the figure by arm


def write_figures(loaded: LoadedStudy, store: Store) -> list[Path]:
    """Write error-arms.png, and error-FIELD.png for every swept field; the same rows give the same
    bytes.
    """
    paths = []
    for field in (ARMS, *loaded.paths):
        drawing = error_figure(loaded, store, field)
        if drawing is not None:
            name = re.sub(r"[^A-Za-z0-9._+-]+", "_", field)
            paths.append(store.folder / f"error-{name}.png")
            style.save(drawing, paths[-1])
    return paths


def error_figure(loaded: LoadedStudy, store: Store, field: str) -> Figure | None:
    """Draw the mean total error with its 95 % interval against a field, or by arm for the field
    ARMS, at most LISTED arms; None if no trial has an error.

    If several arms share a value, each trial is represented by its mean over these arms.
    """
    by_arm = field == ARMS
    shown = loaded.arms[:LISTED] if by_arm else loaded.arms
    names = dict.fromkeys(arm.controller for arm in shown)
    curves = dict[str, list[FieldValue]]()
    for name in names:
        arms = [arm for arm in shown if arm.controller == name]
        groups = field_values(loaded, store, field, arms)
        if by_arm:
            groups = [FieldValue(arm.name, 1, error_of(loaded, store, [arm])) for arm in arms]
        curves[name] = [group for group in groups if group.error.n > 0]
    every = [group for found in curves.values() for group in found]
    if not every:
        return None
    with style.styled():
        longest = max(len(str(group.value)) for group in every) if by_arm else 0
        # width of a character of an arm's name [inches]
        figure = style.figure(style.PAGE_IN, 2.8 + 0.05 * longest)
        axes = figure.subplots()
        places = _places(axes, every)
        for number, (name, found) in enumerate(curves.items()):
            x = [places[as_yaml(group.value)] for group in found]
            joined = numeric(every) and _alike(found, len(loaded.paths))
            look = {"color": PALETTE[number % len(PALETTE)], "clip_on": False}
            # shifted sideways, so that no curve hides another
            # horizontal distance between two controllers at the same value [inches]
            aside_in = 0 if by_arm else 0.06 * (number - (len(curves) - 1) / 2)
            look["transform"] = axes.transData + ScaledTranslation(
                aside_in, 0, figure.dpi_scale_trans
            )
            _draw(axes, x, found, "-o" if joined else "o", name, look)
        if by_arm:
            axes.set_xticks(list(places.values()), [str(group.value) for group in every])
            axes.tick_params(axis="x", rotation=90, labelsize=6 if len(every) < LISTED / 2 else 4)
        axes.set_xlabel("" if by_arm else field)
        axes.set_ylabel(f"total error [{unit_of(loaded.unit)}]")
        axes.set_ylim(bottom=0)
        axes.grid(axis="y", color=style.FAINT, linewidth=0.6)
        axes.set_axisbelow(True)
        if any(names):
            figure.legend(loc="outside lower center", ncols=4)
    style.headline(figure, _headline(loaded, every))
    return figure


def _places(axes: Axes, found: Sequence[FieldValue]) -> dict[str, float]:
    """Return the position of each value on the x axis, and label the axis."""
    if not numeric(found):
        labels = {as_yaml(group.value): shown(group.value) for group in found}
        # largest length of a value's text [characters]
        axes.set_xticks(range(len(labels)), [label[:24] for label in labels.values()])
        axes.set_xlim(-0.5, len(labels) - 0.5)
        return {value: float(place) for place, value in enumerate(labels)}
    values = sorted({float(group.value) for group in found})
    # least span of positive values for a logarithmic axis [decades]
    if min(values) > 0 and max(values) / min(values) >= 10**1.5:
        axes.set_xscale("log")
    if len(values) <= 8:  # largest number of values for which each value has a tick
        axes.set_xticks(values, [shown(value) for value in values])
    return {as_yaml(group.value): float(group.value) for group in found}


def _alike(found: Sequence[FieldValue], fields: int) -> bool:
    """Return whether the arms at neighbouring values differ only in the field, so that a line may
    connect them."""
    return len({group.arms for group in found}) == 1 and (fields == 1 or found[0].arms > 1)


def _draw(
    axes: Axes,
    x: list[float],
    found: Sequence[FieldValue],
    line: str,
    name: str,
    look: dict[str, Any],
) -> None:
    means = [group.error.mean for group in found]
    axes.plot(x, means, line, markersize=3.5, label=name or None, zorder=3, **look)
    known = [(place, g.error.ci95) for place, g in zip(x, found, strict=True) if g.error.ci95.known]
    axes.vlines(
        [place for place, _ in known],
        [interval.low for _, interval in known],
        [interval.high for _, interval in known],
        linewidth=2.5,
        alpha=0.45,
        **look,
    )
    for place, group in zip(x, found, strict=True):  # shifted points do not determine the limits
        ends = group.error.ci95.ends or [group.error.mean]
        axes.update_datalim([(place, end) for end in ends])
    axes.autoscale_view()


def _headline(loaded: LoadedStudy, found: Sequence[FieldValue]) -> str:
    """Return the title: study, plants, the statistic drawn, and the number of trials."""
    plants = sorted(set(origins(loaded)))
    counts = sorted({group.error.n for group in found})
    n = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    pooled = " over the other fields" if any(group.arms > 1 for group in found) else ""
    return (
        f"{loaded.study.name}, {' and '.join(plants)}: mean{pooled} and its 95 % interval,"
        f" n = {n} trials"
    )
