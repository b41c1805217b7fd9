"""The rows of every table: which figures stand where, and how they are rounded."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from tetractl.experiment.experiment import Experiment
from tetractl.log.read.trial_log import ResultSummary
from tetractl.stats.estimate import Distribution, Interval
from tetractl.stats.summary import Comparison, Summary
from tetractl.stats.trials import counts, listing

NONE = "-"


@dataclass(frozen=True, slots=True)
class Grid:
    """One table of text cells, `header` above `rows`; figures stand in all columns but the first,
    unless `words` says that no column holds figures."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    words: bool = False


def grids(summary: Summary, comparison: Comparison | None = None) -> list[Grid]:
    """Lay out a summary: the errors, the other figures, the comparison, the trials left out."""
    tables = [_errors(summary, comparison), _figures(summary)]
    if comparison:
        tables.append(_comparison(comparison))
    odd = [trial for trial in summary.trials if trial.recovered or not counts(trial)]
    return [*tables, _odd(odd)] if odd else tables


def _errors(summary: Summary, comparison: Comparison | None) -> Grid:
    show = _lengths(summary.total.mean, _finest(summary.experiment))
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
    interval = _range(values.ci95, show)
    if values.ci95.method == "t":
        interval += " (t)"
    return (name, str(values.n), *map(show, figures), interval)


def _figures(summary: Summary) -> Grid:
    n = len(summary.trials)
    rows = []
    if summary.published:
        found = summary.published.comparison
        show = _lengths(found.value)
        rows += [
            (f"ours minus published [{summary.unit}]", show(found.value)),
            (f"  its 95 % interval [{summary.unit}]", _range(found.ci95, show)),
            ("  p (Welch)", _p_value(found.p_value)),
        ]
    if scaled := summary.scaled:
        show_scaled = _lengths(scaled.error)
        unit = scaled.scale.unit
        rows += [
            (
                f"mean error a robot, scaled to {scaled.scale.name} [{unit}]",
                show_scaled(scaled.error),
            ),
            (f"  its 95 % interval [{unit}]", _range(scaled.ci95, show_scaled)),
            ("  in body lengths", _digits(scaled.body_lengths(scaled.error))),
        ]
        if math.isfinite(scaled.published):
            lengths = _digits(scaled.body_lengths(scaled.published))
            text = f"{_lengths(scaled.published)(scaled.published)} ({lengths} body lengths)"
            rows.append((f"  published, scaled alike [{unit}]", text))
    rows += [
        ("arrived", _arrived(summary)),
        (
            "entered an obstacle",
            f"{summary.obstacle_violations} of {n}{_percent(summary.violations_ci95)}",
        ),
        ("aborted", str(summary.aborted)),
        ("interrupted", str(summary.interrupted)),
        ("read from damaged logs", str(sum(trial.recovered for trial in summary.trials))),
        ("logs that could not be read", str(len(summary.damaged))),
        ("solve time p50 [ms]", _digits(summary.solve_ms.p50)),
        ("solve time p99 [ms]", _digits(summary.solve_ms.p99)),
        ("solve time max [ms]", _digits(summary.solve_ms.max)),
        ("deadline misses", str(summary.deadline_misses)),
    ]
    return Grid("Trials", ("figure", "value"), tuple(rows), words=True)


def _arrived(summary: Summary) -> str:
    if summary.experiment.controller.arrival_tolerance == 0:
        return f"{NONE} (no arrival_tolerance set)"
    return f"{summary.arrived} of {len(summary.trials)}{_percent(summary.arrived_ci95)}"


def _comparison(comparison: Comparison) -> Grid:
    unit = comparison.ours.unit
    found = comparison.welch
    show = _lengths(found.value, _finest(comparison.ours.experiment))
    verdict = comparison.verdict or f"none: {comparison.reason}"
    rows = [
        ("n", f"{comparison.ours.counted} and {comparison.theirs.counted}"),
        (f"difference of the means [{unit}]", show(found.value)),
        (f"  95 % interval, Welch [{unit}]", _range(found.ci95, show)),
        (f"  95 % interval, bootstrap [{unit}]", _range(comparison.bootstrap, show)),
        ("  p (Welch)", _p_value(found.p_value)),
        ("Cliff's delta", _fixed(2)(comparison.effect.value)),
        ("  95 % interval", _range(comparison.effect.ci95, _fixed(2))),
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


def _fixed(decimals: int) -> Callable[[float], str]:
    def show(value: float) -> str:
        return f"{value:.{decimals}f}" if math.isfinite(value) else NONE

    return show


def _lengths(scale: float, finest: int = 9) -> Callable[[float], str]:
    """Show lengths with the decimals that give `scale` three digits, but at most `finest`; with one
    decimal at least below 1000."""
    scale = abs(scale)
    digits = math.floor(math.log10(scale)) if math.isfinite(scale) and scale > 0 else 1
    return _fixed(min(max(2 - digits, int(digits < 3)), finest))


def _finest(experiment: Experiment) -> int:
    """Return the decimals of about a millionth of the arena: less than that is no one's error."""
    extent = max(experiment.arena.width, experiment.arena.height)
    return min(max(6 - math.floor(math.log10(extent)), 0), 9)


def _digits(value: float) -> str:
    """Show three significant digits."""
    if value <= 0 or not math.isfinite(value):
        return _fixed(0)(value)
    return _fixed(min(max(2 - math.floor(math.log10(value)), 0), 9))(value)


def _range(interval: Interval, show: Callable[[float], str]) -> str:
    if interval.known:
        return f"{show(interval.low)} to {show(interval.high)}"
    return f"none: {interval.reason}" if interval.reason else NONE


def _percent(interval: Interval) -> str:
    if not interval.known:
        return ""
    return f" (95 % interval {100 * interval.low:.0f} to {100 * interval.high:.0f} %)"


def _p_value(p: float) -> str:
    if not math.isfinite(p):
        return NONE
    return f"{p:.2g}" if p >= 0.001 else "< 0.001"
