"""The tables of several arms: their errors, what happened in them, and every two compared."""

from collections.abc import Callable
from typing import Any

from tetractl.stats.arms import Arms, Contrast, NotCompared
from tetractl.stats.estimate import proportion_interval
from tetractl.stats.rows import Grid, finest
from tetractl.stats.text import NONE, fixed, lengths, p_value, percent, span
from tetractl.stats.trials import listing


def arms_grids(arms: Arms) -> list[Grid]:
    """Return the tables of several arms."""
    return [_errors(arms), _shares(arms), *_contrasts(arms)]


def _errors(arms: Arms) -> Grid:
    means = [arm.summary.total.mean for arm in arms.arms]
    show = lengths(max(means), finest(arms.arms[0].summary.experiment))
    rows = []
    for arm in arms.arms:
        values = arm.summary.total
        figures = (values.mean, values.std, values.median, values.min, values.max)
        rows.append((arm.name, str(values.n), *map(show, figures), span(values.ci95, show)))
    header = (f"error [{arms.unit}]", "n", "mean", "std", "median", "min", "max", "95 % interval")
    steered = ", ".join(dict.fromkeys(str(arm.summary.origin) for arm in arms.arms))
    return Grid(f"Final total errors of {len(rows)} arms", header, tuple(rows), note=steered)


def _shares(arms: Arms) -> Grid:
    rows = []
    for arm in arms.arms:
        summary = arm.summary
        n, items = len(summary.trials), summary.items
        found = (summary.counted, *(items.get(key) for key in ("arrived", *_BAD)))
        rows.append((arm.name, str(summary.origin), *(_share(one, n) for one in found)))
    header = ("arm", "steered", "complete", "arrived", "entered an obstacle", "left the arena")
    return Grid("What happened, with 95 % intervals (Wilson)", header, tuple(rows), words=True)


_BAD = ("obstacle_violations", "left_arena")


def _share(found: Any, n: int) -> str:
    if not isinstance(found, int):  # arrived, where no tolerance is set
        return NONE
    return f"{found} of {n}{percent(proportion_interval(found, n))}"


def _contrasts(arms: Arms) -> list[Grid]:
    tested = [one for one in arms.contrasts if isinstance(one, Contrast)]
    unlike = [one for one in arms.contrasts if isinstance(one, NotCompared)]
    sizes = [abs(one.difference.value) for one in tested]
    show = lengths(max(sizes, default=0.0), finest(arms.arms[0].summary.experiment))
    tables = []
    if tested:
        unit = arms.unit
        header = (
            "one minus other",
            "trials",
            f"difference [{unit}]",
            "95 % interval",
            "p (Holm)",
            "in sd of pairs",
            "Cliff's delta",
            "sd ratio",
            "p (Holm)",
            "verdict on the mean error",
        )
        rows = tuple(_row(one, show) for one in tested)
        tables.append(Grid("Every two arms", header, rows, words=True))
        tables.append(_fine_print(tested))
    if unlike:
        rows = tuple((f"{one.one.name}, {one.other.name}", one.reason) for one in unlike)
        title = "Not compared, since they are not alike"
        tables.append(Grid(title, ("arms", "steered"), rows, words=True))
    return tables


def _row(one: Contrast, show: Callable[[float], str]) -> tuple[str, ...]:
    two = fixed(2)
    counted = f"{one.one.summary.counted} and {one.other.summary.counted}"
    return (
        f"{one.one.name} - {one.other.name}",
        f"{one.pairs} pairs" if one.pairs else counted,
        show(one.difference.value),
        span(one.difference.ci95, show),
        f"{p_value(one.p_holm)} ({one.test})",
        f"{two(one.standardised.value)} ({span(one.standardised.ci95, two)})"
        if one.pairs
        else NONE,
        f"{two(one.delta.value)} ({span(one.delta.ci95, two)})",
        f"{two(one.deviations.value)} ({span(one.deviations.ci95, two)})",
        p_value(one.deviation_p_holm),
        one.verdict or f"none: {one.reason}",
    )


def _fine_print(tested: list[Contrast]) -> Grid:
    """Return what each comparison can show, and between what it is."""
    rows = tuple(
        (
            f"{one.one.name} - {one.other.name}",
            detects(one) or NONE,
            one.why_unpaired or NONE,
            listing(one.differs) or "nothing",
        )
        for one in tested
    )
    header = ("one minus other", "what n can show", "why not paired", "differs in")
    return Grid("What the comparisons rest on", header, rows, words=True)


def detects(one: Contrast) -> str:
    """Return what so many trials can show, such as "20 pairs detect 0.66 sd at 80 %"."""
    if not one.detects > 0:
        return ""
    what = f"{one.pairs} pairs detect" if one.pairs else f"{_both(one)} trials detect"
    return f"{what} {fixed(2)(one.detects)} sd at 80 %"


def _both(one: Contrast) -> str:
    return f"{one.one.summary.counted} and {one.other.summary.counted}"
