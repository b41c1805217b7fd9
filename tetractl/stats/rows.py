"""The rows of every table: which statistics stand where, with how many digits."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from tetractl.experiment.experiment import Experiment
from tetractl.log.read.origin import Origin
from tetractl.stats.comparison import Comparison
from tetractl.stats.estimate import Distribution
from tetractl.stats.notable import to_look_at
from tetractl.stats.summary import Summary
from tetractl.stats.text import NONE, digits, fixed, lengths, p_value, span
from tetractl.stats.trials import listing

_SHOWN = 20  # trials to look at, before a table gets too long to read


@dataclass(frozen=True, slots=True)
class Grid:
    """One table of text cells, `header` above `rows`; numbers stand in all columns but the first,
    in none where `words` is True. `note` says what must not be lost where the title is."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    words: bool = False
    note: str = ""


def grids(summary: Summary, comparison: Comparison | None = None) -> list[Grid]:
    """Return the tables of a summary: errors, statistics, comparison, and trials left out."""
    tables = [_errors(summary, comparison), _statistics(summary)]
    if comparison:
        tables.append(_comparison(comparison))
    notable = to_look_at(summary)
    shown = [(trial.path, trial.outcome, ", ".join(trial.notes)) for trial in notable[:_SHOWN]]
    if len(notable) > _SHOWN:
        shown.append((f"{len(notable) - _SHOWN} more", NONE, "--format json names all"))
    look = Grid("Trials to look at", ("log", "outcome", "note"), tuple(shown), words=True)
    return [*tables, look] if shown else tables


def _errors(summary: Summary, comparison: Comparison | None) -> Grid:
    show = lengths(summary.total.mean, finest(summary.experiment))
    rows = [_row("total", summary.total, show)]
    if comparison:
        rows.append(_row("against", comparison.theirs.total, show))
    if summary.published:
        reference = summary.published.reference
        known = (str(reference.n), f"{reference.mean:g}", f"{reference.std:g}")
        rows.append(("published", *known, NONE, NONE, NONE, NONE))
    names = (robot.name for robot in summary.experiment.robots)
    rows += [_row(name, robot, show) for name, robot in zip(names, summary.robots, strict=True)]
    complete = f"{summary.counted} of {len(summary.trials)} trials complete"
    batch = f"{summary.experiment.name}, {summary.origin}"
    title = f"{batch}: final error [{summary.unit}], {complete}"
    return Grid(
        title,
        (f"error [{summary.unit}]", "n", "mean", "std", "median", "min", "max", "95 % interval"),
        tuple(rows),
        note=f"{batch}, {complete}",
    )


def _row(name: str, values: Distribution, show: Callable[[float], str]) -> tuple[str, ...]:
    figures = (values.mean, values.std, values.median, values.min, values.max)
    return (name, str(values.n), *map(show, figures), span(values.ci95, show))


def _statistics(summary: Summary) -> Grid:
    rows = [("what was steered", str(summary.origin))]
    if summary.origin is Origin.DISTURBED:
        rows.append(("  its disturbances", "assumed in the spec, not measured"))
    if summary.published:
        found = summary.published.comparison
        if found is None:
            rows.append(("ours minus published", f"{NONE} (not real robots: not compared)"))
        else:
            show = lengths(found.value)
            rows += [
                (f"ours minus published [{summary.unit}]", show(found.value)),
                (f"  its 95 % interval [{summary.unit}]", span(found.ci95, show)),
                ("  p (Welch)", p_value(found.p_value)),
            ]
    if scaled := summary.scaled:
        show_scaled = lengths(scaled.error)
        unit = scaled.scale.unit
        rows += [
            (
                f"mean error a robot, scaled to {scaled.scale.name} [{unit}]",
                show_scaled(scaled.error),
            ),
            (f"  its 95 % interval [{unit}]", span(scaled.ci95, show_scaled)),
            ("  in body lengths", digits(scaled.body_lengths(scaled.error))),
        ]
        if math.isfinite(scaled.published):
            in_bodies = digits(scaled.body_lengths(scaled.published))
            text = f"{lengths(scaled.published)(scaled.published)} ({in_bodies} body lengths)"
            rows.append((f"  published, scaled alike [{unit}]", text))
    rows += [
        *(row for value in summary.statistics for row in value.rows),
        ("earlier attempts, not counted", str(summary.n_attempts)),
        ("logs that could not be read", str(len(summary.damaged))),
    ]
    return Grid("Trials", ("figure", "value"), tuple(rows), words=True)


def _comparison(comparison: Comparison) -> Grid:
    unit = comparison.ours.unit
    found = comparison.welch
    show = lengths(found.value, finest(comparison.ours.experiment))
    verdict = comparison.verdict or f"none: {comparison.reason}"
    rows = [
        ("steered in ours", str(comparison.ours.origin)),
        ("steered in the other", str(comparison.theirs.origin)),
        ("n", f"{comparison.ours.counted} and {comparison.theirs.counted}"),
        (f"difference of the means [{unit}]", show(found.value)),
        (f"  95 % interval, Welch [{unit}]", span(found.ci95, show)),
        (f"  95 % interval, of both [{unit}]", span(comparison.both, show)),
        ("  p (Welch)", p_value(found.p_value)),
        *_paired(comparison, show),
        ("Cliff's delta", fixed(2)(comparison.effect.value)),
        ("  95 % interval", span(comparison.effect.ci95, fixed(2))),
        ("verdict on the mean error", verdict),
        ("differs in", listing(comparison.differs) or "nothing"),
    ]
    return Grid("Ours against the other batch", ("figure", "value"), tuple(rows), words=True)


def _paired(comparison: Comparison, show: Callable[[float], str]) -> list[tuple[str, str]]:
    unit, paired = comparison.ours.unit, comparison.paired
    if (found := paired.difference) is None:
        return [("pairs of the same world", f"none: {paired.reason}")]
    return [
        ("pairs of the same world (seed, trial)", str(paired.n)),
        (f"  mean difference of the pairs [{unit}]", show(found.value)),
        (f"  95 % interval, paired t [{unit}]", span(found.ci95, show)),
        ("  p (paired t)", p_value(found.p_value)),
    ]


def finest(experiment: Experiment) -> int:
    """Return the decimals of about a millionth of the arena, below which an error means nothing."""
    extent = max(experiment.arena.width, experiment.arena.height)
    return min(max(6 - math.floor(math.log10(extent)), 0), 9)
