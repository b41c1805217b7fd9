"""Total errors against a swept field: the mean with its 95 % interval, a dot for each trial."""

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import ScaledTranslation

from tetractl.core.errors import unit_of
from tetractl.results.estimate import ArmErrors, numeric
from tetractl.view import style
from tetractl.view.figures.axes import name_categories


@style.styled()
def errors_by(
    curves: Mapping[str, Sequence[ArmErrors]], field: str, unit: str, only: bool = True
) -> Figure:
    """Draw errors against the values of a field, in the colours of the curves; for the field "",
    against arms, whose labels are their names.

    A line connects numbers if arms at neighbouring values differ only in the field: if it is the
    `only` one that is swept, or each value stands for several arms, always the same number.
    """
    every = [arm for found in curves.values() for arm in found]
    figure = style.figure(style.PAGE_IN, 2.8)
    axes = figure.subplots()
    places = _places(axes, every)
    for number, (name, found) in enumerate(curves.items()):
        x = [places[repr(arm.value)] for arm in found]
        alike = len({arm.arms for arm in found}) == 1 and (only or found[0].arms > 1)
        # shifted sideways, so that no curve hides another
        # horizontal distance between two curves at the same value [inches]
        aside_in = 0.12 * (number - (len(curves) - 1) / 2) if field else 0
        # and between the mean and its trials
        left_in = aside_in - min(0.06, 2.5 / len(places))
        look = {"color": style.batch_look(number)["color"], "clip_on": False}
        shifts = [ScaledTranslation(by, 0, figure.dpi_scale_trans) for by in (aside_in, left_in)]
        looks = [look | {"transform": axes.transData + shift} for shift in shifts]
        _draw(axes, x, found, "-o" if numeric(every) and alike else "o", name, *looks)
    if not field:
        name_categories(axes, [arm.label for arm in every], 0.9 * style.PAGE_IN)
    axes.set_xlabel(field)
    axes.set_ylabel(f"total error [{unit_of(unit)}]")
    axes.set_ylim(bottom=0)
    axes.grid(axis="y", color=style.FAINT, linewidth=0.6)
    axes.set_axisbelow(True)
    if any(curves):
        figure.legend(loc="outside lower center", ncols=4)
    return figure


def _places(axes: Axes, found: Sequence[ArmErrors]) -> dict[str, float]:
    """Return the position of each value on the x axis, and label the axis."""
    if not numeric(found):
        labels = {repr(arm.value): arm.label for arm in found}
        # largest length of a value's text [characters]
        axes.set_xticks(range(len(labels)), [label[:24] for label in labels.values()])
        axes.set_xlim(-0.5, len(labels) - 0.5)
        return {value: float(place) for place, value in enumerate(labels)}
    values = {float(arm.value): arm.label for arm in sorted(found, key=lambda arm: arm.value)}
    # least span of positive values for a logarithmic axis [decades]
    if min(values) > 0 and max(values) / min(values) >= 10**1.5:
        axes.set_xscale("log")
    if len(values) <= 8:  # largest number of values for which each value has a tick
        axes.set_xticks(list(values), list(values.values()))
    return {repr(arm.value): float(arm.value) for arm in found}


def _draw(
    axes: Axes,
    x: list[float],
    found: Sequence[ArmErrors],
    line: str,
    name: str,
    mean: dict[str, Any],
    trial: dict[str, Any],
) -> None:
    """Draw means with their intervals, in the look `mean`, and a dot for each trial."""
    means = [arm.error.mean for arm in found]
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
