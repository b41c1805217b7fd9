"""The rows of every table: which statistics stand where, with how many digits."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from tetractl.experiment.experiment import Experiment
from tetractl.log.read.trial_log import ResultSummary
from tetractl.stats.estimate import Distribution
from tetractl.stats.summary import Comparison, Summary
from tetractl.stats.text import NONE, digits, fixed, lengths, p_value, span
from tetractl.stats.trials import counts, listing


@dataclass(frozen=True, slots=True)
class Grid:
    """One table of text cells, `header` above `rows`; numbers stand in all columns but the first,
    in none where `words` is True."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    words: bool = False


def grids(summary: Summary, comparison: Comparison | None = None) -> list[Grid]:
    """Return the tables of a summary: errors, statistics, comparison, and trials left out."""
    tables = [_errors(summary, comparison), _statistics(summary)]
    if comparison:
        tables.append(_comparison(comparison))
    odd = [trial for trial in summary.trials if trial.recovered or not counts(trial)]
    return [*tables, _odd(odd)] if odd else tables


def _errors(summary: Summary, comparison: Comparison | None) -> Grid:
    show = lengths(summary.total.mean, _finest(summary.experiment))
    rows = [_row("total", summary.total, show)]
    if comparison:
        rows.append(_row("against", comparison.theirs.total, show))
    if summary.published:
        reference = summary.published.reference
        known = (str(reference.n), f"{reference.mean:g}", f"{reference.std:g}")
        rows.append(("published", *known, NONE, NONE, NONE, NONE))
    names = (robot.name for robot in summary.experiment.robots)
    rows += [_row(name, robot, show) for name, robot in zip(names, summary.robots, strict=True)]
    title = (
        f"{summary.experiment.name}: distance to the targets at the end [{summary.unit}],"
        f" {summary.counted} of {len(summary.trials)} trials complete"
    )
    return Grid(
        title,
        ("error", "n", "mean", "std", "median", "min", "max", "95 % interval"),
        tuple(rows),
    )


def _row(name: str, values: Distribution, show: Callable[[float], str]) -> tuple[str, ...]:
    figures = (values.mean, values.std, values.median, values.min, values.max)
    interval = span(values.ci95, show)
    if values.ci95.method == "t":
        interval += " (t)"
    return (name, str(values.n), *map(show, figures), interval)


def _statistics(summary: Summary) -> Grid:
    rows = []
    if summary.published:
        found = summary.published.comparison
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
        ("logs that could not be read", str(len(summary.damaged))),
    ]
    return Grid("Trials", ("figure", "value"), tuple(rows), words=True)


def _comparison(comparison: Comparison) -> Grid:
    unit = comparison.ours.unit
    found = comparison.welch
    show = lengths(found.value, _finest(comparison.ours.experiment))
    verdict = comparison.verdict or f"none: {comparison.reason}"
    rows = [
        ("n", f"{comparison.ours.counted} and {comparison.theirs.counted}"),
        (f"difference of the means [{unit}]", show(found.value)),
        (f"  95 % interval, Welch [{unit}]", span(found.ci95, show)),
        (f"  95 % interval, bootstrap [{unit}]", span(comparison.bootstrap, show)),
        ("  p (Welch)", p_value(found.p_value)),
        ("Cliff's delta", fixed(2)(comparison.effect.value)),
        ("  95 % interval", span(comparison.effect.ci95, fixed(2))),
        ("verdict on the mean error", verdict),
        ("differs in", listing(comparison.differs) or "nothing"),
    ]
    return Grid("Ours against the other batch", ("figure", "value"), tuple(rows), words=True)


def _odd(trials: Sequence[ResultSummary]) -> Grid:
    rows = []
    for trial in trials:
        notes = ["in the means" if counts(trial) else "not in the means"]
        if trial.recovered:
            notes.append("read from a damaged log")
        if trial.result.reason:
            notes.append(trial.result.reason)
        rows.append((trial.path, trial.outcome.value, ", ".join(notes)))
    return Grid("Trials to look at", ("log", "outcome", "note"), tuple(rows), words=True)


def _finest(experiment: Experiment) -> int:
    """Return the decimals of about a millionth of the arena, below which an error means nothing."""
    extent = max(experiment.arena.width, experiment.arena.height)
    return min(max(6 - math.floor(math.log10(extent)), 0), 9)
