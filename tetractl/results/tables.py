"""Formats batches and their comparisons as tables for display."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from tetractl.core.table.table import NONE, Column, Table, fixed, lengths, p_value
from tetractl.core.table.table_files import flat
from tetractl.core.table.terminal_table import LISTED_MAX
from tetractl.experiment.experiment import Experiment
from tetractl.log.read.trial_log import Origin
from tetractl.results.contrast import BatchComparison, Contrast
from tetractl.results.describe import PUBLISHED, BatchStatistics, flagged
from tetractl.results.estimate import Distribution, Interval, known_distribution
from tetractl.results.open_batch import listing
from tetractl.results.outcomes import unsafe
from tetractl.results.trial_tables import trials_table


def summary(found: BatchComparison) -> list[Table]:
    """Return what one needs: the total errors, and below them the verdict and what is not usual.

    Of three batches or more, the verdicts are in a table of their own.
    """
    groups, several = found.groups, len(found.groups) > 2
    errors, compared = _errors(groups, robots=False), _contrasts(found.contrasts)[:1]
    lines = [] if several else [f"{one.name}: {_verdict(one)}" for one in found.contrasts]
    if len(groups) == 1 and groups[0].experiment.reference and groups[0].origin.comparable:
        lines.append(f"{PUBLISHED}: {groups[0].rows[PUBLISHED]}")
    lines += [f"{label}: {text}" for label, text in _unusual(groups)]
    errors = replace(errors, note="\n".join(filter(None, [*lines, errors.note])))
    return [errors, *(compared if several else [])]


def _verdict(one: Contrast) -> str:
    """Return the verdict of a comparison with its difference and test, in words."""
    test, alike = one.tests.partition(",")[0], one.verdict == "undecided"
    found = "no significant difference" if alike else f"{one.verdict} mean error"
    found = f"no verdict ({one.reason})" if one.verdict is None else found
    show = lengths(one.difference.value, finest(one.one.experiment))
    basis = f"{test}, {one.counted}" if one.pairs else test  # else n is in the table
    return f"{found}, {one.difference.text(one.one.unit, show, one.p_holm)} ({basis})"


def _unusual(groups: Sequence[BatchStatistics]) -> Iterator[tuple[str, str]]:
    """Yield label and text of every value that is not usual, and of the flagged trials."""
    rows, several = dict[str, dict[str, list[str]]](), len(groups) > 1

    def add(label: str, text: str, name: str) -> None:
        rows.setdefault(label, {}).setdefault(text, []).append(name)

    for group in groups:
        for value in (value for value in group.values if not value.usual):
            for label, text in value.rows:
                if shown := text if value.brief is None or not several else value.brief:
                    add(label, shown, group.name)
        odd = [(Path(t.log).stem, ", ".join(t.notes)) for t in flagged(group.batch)]
        if several:  # one of each batch: the others are named in full
            more = f" and {len(odd) - 1} more" if odd[1:] else ""
            odd = [(group.name, f"{trial} ({notes}){more}") for trial, notes in odd[:1]]
        for trial, notes in odd:
            add("flagged", notes, trial)
    every = [group.name for group in groups]
    for label, texts in rows.items():
        named = (t if names == every else f"{listing(names)}: {t}" for t, names in texts.items())
        yield label, listing(list(named), "; ")


def tables(found: BatchComparison) -> list[Table]:
    """Return every table: errors, how the trials ended, comparisons, flagged trials."""
    groups = found.groups
    names = [group.name for group in groups] if len(groups) > 1 else ["value"]
    parts = [slice(i, i + 3) for i in range(0, len(groups), 3)]  # more are too wide
    trials = [_trials(groups[part], names[part]) for part in parts]
    odd = [trial for group in groups for trial in flagged(group.batch)]
    rows = [(trial.log, trial.outcome, ", ".join(trial.notes)) for trial in odd[:LISTED_MAX]]
    if len(odd) > LISTED_MAX:
        rows.append((f"{len(odd) - LISTED_MAX} more", NONE, "in --format json"))
    listed = Table.of_texts("Flagged trials", ("log", "outcome", "note"), rows)
    every = [_errors(groups), *trials, *_contrasts(found.contrasts), listed]
    return [table for table in every if len(table)]


def error_format(least: float, finest: int) -> Callable[[float], str]:
    """Return a format with three digits for errors of about `least`, the least mean; much larger
    values have fewer decimals, and none has more than `finest`.
    """
    decimals = lengths(least, finest)

    def show(value: float) -> str:
        return lengths(value, finest)(value) if value > 10 * least > 0 else decimals(value)

    return show


def error_table(
    title: str,
    named: Sequence[tuple[str, Distribution]],
    unit: str,
    scale: float | None = None,
    finest: int = 9,
) -> Table:
    """Return one row per named distribution of errors, in the format for the least mean or, if
    given, for `scale`.
    """
    means = [values.mean for _, values in named if values.mean > 0]
    show = error_format(min(means, default=0.0) if scale is None else scale, finest)

    def column(name: str, of: Callable[[Distribution], float]) -> Column:
        return Column(name, [of(values) for _, values in named], format=show)

    def interval(ends: Interval) -> str:
        return ends.text(show)

    return Table(
        title,
        (
            Column("error", [name for name, _ in named], unit),
            Column("n", [values.n for _, values in named]),
            column("mean", lambda values: values.mean),
            column("std", lambda values: values.std),
            column("median", lambda values: values.median),
            column("min", lambda values: values.min),
            column("max", lambda values: values.max),
            Column("95 % interval", [values.ci95 for _, values in named], format=interval),
        ),
    )


def _errors(groups: Sequence[BatchStatistics], robots: bool = True) -> Table:
    """Return the table of total errors and, of one batch, of the errors of its robots."""
    first, each = groups[0], list[tuple[str, Distribution]]()
    plants = ", ".join(dict.fromkeys(str(group.origin) for group in groups))
    if len(groups) == 1:
        named = [("total", first.total)]
        valid = f"{first.counted} of {len(first.batch.trials)} trials valid"
        title = f"{first.experiment.name}, {plants}: final error [{first.unit}], {valid}"
        if robots:
            each = list(zip(first.experiment.setup.names, first.robots, strict=True))
    else:
        named = [(group.name, group.total) for group in groups]
        title = f"Final total errors of {len(groups)} batches, {plants}"
        assumed = any(group.origin is Origin.DISTURBED for group in groups)
        title += " (disturbances assumed)" * assumed
    for group in groups:
        known = group.experiment.reference
        if known and all(name != "published" for name, _ in named):
            row = known_distribution(known.n, known.mean, known.std, Interval.none(""))
            named.append(("published", row))
    scale = min((group.total.mean for group in groups if group.counted), default=math.nan)
    errors = error_table(title, [*named, *each], first.unit, scale, finest(first.experiment))
    simulated = (trial for group in groups for trial in group.batch.trials if trial.simulated)
    return replace(errors, note=processors_note(trial.processor for trial in simulated))


def processors_note(types: Iterable[str]) -> str:
    """Return a note if trials were simulated on several types of processor, otherwise "".

    Sums round differently on two types, and a trial with disturbances may then take another course.
    """
    found = Counter(filter(None, types))
    if len(found) < 2:
        return ""
    listed = ", ".join(f"{name} ({count})" for name, count in found.most_common(4))
    more = f" and {len(found) - 4} more" if len(found) > 4 else ""
    what = "types of processor, on which the same seed may give another trial"
    return f"trials of {len(found)} {what}: {listed}{more}"


def _trials(groups: Sequence[BatchStatistics], names: Sequence[str]) -> Table:
    """Return a table of some batches: a row per statistic, a column per batch."""
    columns = [group.rows for group in groups]
    labels = list(dict.fromkeys(label for column in columns for label in column))
    return Table(
        "Trials",
        (
            Column("figure", labels),
            *(
                Column(name, [column.get(label) for label in labels], words=True)
                for name, column in zip(names, columns, strict=True)
            ),
        ),
    )


def _contrasts(found: Sequence[Contrast]) -> list[Table]:
    """Return two tables: the differences of the means with their tests, and what these rest on."""
    if not found:
        return []
    first = found[0].one
    sizes = [abs(one.difference.value) for one in found]
    show = lengths(max(filter(math.isfinite, sizes), default=0.0), finest(first.experiment))
    names = Column("one - other", [one.name for one in found])
    verdicts = [one.verdict or f"none: {one.reason}" for one in found]
    compared = "Comparison of the mean total errors"
    if any(one.alike for one in found) and len(found) > 1:
        compared += f", p corrected for {len(found)} tests"
    differences = Table(
        compared,
        (
            names,
            Column("trials", [one.counted for one in found], words=True),
            Column("difference", [one.difference.value for one in found], first.unit, show),
            Column("95 % interval", [one.difference.ci95.text(show) for one in found]),
            Column("p (Holm)", [one.p_holm for one in found], format=p_value),
            Column("verdict on the mean error", verdicts, words=True),
        ),
    )
    basis = Table.of_texts(
        "What the comparisons rest on",
        (
            names.name,
            "tests",
            "p (rank test)",
            "detectable at 80 % power",
            "why not paired",
            "differs in",
        ),
        [
            (
                one.name,
                one.tests if one.alike else NONE,
                p_value(one.rank_p_holm),
                f"{fixed(2)(one.detects)} sd" if one.detects > 0 else NONE,
                one.why_unpaired,
                listing(one.differs) or "nothing",
            )
            for one in found
        ],
    )
    return [differences, basis]


def data_table(found: BatchComparison) -> Table:
    """Return the table of `stats --format csv`: for one batch, a row per trial, earlier attempts
    last; for several batches, a row per comparison, with the same numbers as the JSON.
    """
    if len(found.groups) == 1:
        return trials_table(found.groups[0].batch)
    return Table.of_records("comparisons", [flat(one.record) for one in found.contrasts])


def finest(experiment: Experiment) -> int:
    """Return the number of decimals that shows about a millionth of the arena; smaller errors have
    no meaning.
    """
    extent = max(experiment.arena.width, experiment.arena.height)
    return min(max(6 - math.floor(math.log10(extent)), 0), 9)


def page_trials(group: BatchStatistics, numbers: Mapping[str, int]) -> Table:
    """Return the table of trials in a report: each trial's number on the page, its errors and
    outcome.
    """
    trials = group.batch.trials
    show = lengths(group.total.mean)
    return Table(
        "",
        (
            Column("trial", [numbers.get(trial.log) for trial in trials]),
            Column("log", [trial.log.rpartition("/")[2] for trial in trials]),
            Column("total error", [t.result.total_error for t in trials], group.unit, show),
            Column("duration", [t.result.duration_s for t in trials], "s", fixed(2)),
            Column("steps", [trial.result.steps for trial in trials]),
            Column("unsafe", [", ".join(unsafe(trial)) or "no" for trial in trials]),
            Column("outcome", [trial.outcome.value for trial in trials]),
        ),
        "; ".join(f"{one.value}: {one.meaning}" for one in {t.outcome: 0 for t in trials}),
    )
