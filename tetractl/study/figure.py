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
from tetractl.study.arm_table import LISTED, FieldValue, field_values, group_of, numeric, origins
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
    """Draw the total error of each trial, and the mean with its 95 % interval, against a field, or
    by arm for the field ARMS, at most LISTED arms; None if no trial has an error.

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
            groups = [group_of(loaded, store, arm.name, [arm]) for arm in arms]
        curves[name] = [group for group in groups if group.error.n > 0]
    every = [group for found in curves.values() for group in found]
    if not every:
        return None
    with style.styled():
        figure = style.figure(style.PAGE_IN, 2.8)
        axes = figure.subplots()
        places = _places(axes, every)
        for number, (name, found) in enumerate(curves.items()):
            x = [places[as_yaml(group.value)] for group in found]
            joined = numeric(every) and _alike(found, len(loaded.paths))
            # shifted sideways, so that no curve hides another
            # horizontal distance between two controllers at the same value [inches]
            aside_in = 0 if by_arm else 0.12 * (number - (len(curves) - 1) / 2)
            # and between the mean and its trials
            left_in = aside_in - min(0.06, 2.5 / len(places))
            look = {"color": PALETTE[number % len(PALETTE)], "clip_on": False}
            shifts = [
                ScaledTranslation(by, 0, figure.dpi_scale_trans) for by in (aside_in, left_in)
            ]
            looks = [look | {"transform": axes.transData + shift} for shift in shifts]
            _draw(axes, x, found, "-o" if joined else "o", name, *looks)
        if by_arm:
            _name_arms(figure, axes, [str(group.value) for group in every])
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


def _name_arms(figure: Figure, axes: Axes, names: list[str]) -> None:
    """Label the x axis with the arms' names, and make the figure higher by the labels.

    The names are level, with a line for the controller and for each field, or upright if these
    lines are too long.
    """
    char_in = 0.05  # width of a character [inches]
    level = [re.sub(r"-(?=[\w.]+=)", "\n", name) for name in names]
    longest = max(len(line) for label in level for line in label.split("\n"))
    fits = char_in * (longest + 2) < 0.9 * style.PAGE_IN / len(names)
    axes.set_xticks(range(len(names)), level if fits else names)
    size = 6 if len(names) < LISTED / 2 else 4
    axes.tick_params(axis="x", rotation=0 if fits else 90, labelsize=size)
    lines = max(label.count("\n") for label in level)
    below_in = 0.1 * lines if fits else char_in * max(map(len, names))
    figure.set_figheight(figure.get_figheight() + below_in)


def _draw(
    axes: Axes,
    x: list[float],
    found: Sequence[FieldValue],
    line: str,
    name: str,
    mean: dict[str, Any],
    trial: dict[str, Any],
) -> None:
    """Draw means with their intervals, in the look `mean`, and a dot for each trial."""
    means = [group.error.mean for group in found]
    axes.plot(x, means, line, markersize=3.5, label=name or None, zorder=3, **mean)
    known = [(place, g.error.ci95) for place, g in zip(x, found, strict=True) if g.error.ci95.known]
    axes.vlines(
        [place for place, _ in known],
        [interval.low for _, interval in known],
        [interval.high for _, interval in known],
        linewidth=2.5,
        alpha=0.45,
        **mean,
    )
    dots = [(place, error) for place, g in zip(x, found, strict=True) for error in g.errors]
    places, errors = [place for place, _ in dots], [error for _, error in dots]
    axes.plot(places, errors, "o", markersize=2.5, mew=0, alpha=0.7, gid="trials", **trial)
    ends = [(place, end) for place, interval in known for end in (interval.low, interval.high)]
    if dots:
        axes.update_datalim([*dots, *ends])  # shifted points do not determine the limits
    axes.autoscale_view()


def _headline(loaded: LoadedStudy, found: Sequence[FieldValue]) -> str:
    """Return the title: study, plants, the statistic drawn, and the number of trials."""
    plants = sorted(set(origins(loaded)))
    counts = sorted({group.error.n for group in found})
    n = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    pooled = " over the other fields" if any(group.arms > 1 for group in found) else ""
    return (
        f"{loaded.study.name}, {' and '.join(plants)}: mean{pooled} and its 95 % interval,"
        f" n = {n} trials, each a dot"
    )
