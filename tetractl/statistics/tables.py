"""Create tables of batches and their comparisons, which `stats` and the report page show.

    summary         `stats`, and the end of a run: the errors, the verdict and unusual findings
    tables          `stats --full`: every table
    trials_listed   a row for each trial of a batch, on the report page and in a notebook

`as_json` returns the same numbers for other programs, in JSON and CSV. The CSV table has a row for
each trial of a batch (`trial_tables.trials_table`).
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from tetractl.log.read.trial_log import Origin
from tetractl.spec.experiment import Experiment
from tetractl.statistics.built_in_statistics import MEANINGS
from tetractl.statistics.describe import BatchComparison, BatchStatistics, Contrast
from tetractl.statistics.estimate import Distribution, Interval, known_distribution
from tetractl.statistics.flagged import flagged, unsafe
from tetractl.statistics.mean_difference import MeanDifference
from tetractl.statistics.statistic import Figure
from tetractl.tools.table.table import (
    UNKNOWN_TEXT,
    Column,
    Table,
    create_decimal_format,
    create_length_format,
    format_p_value,
    join_listed,
)
from tetractl.tools.table.terminal_table import LISTED_MAX

DECIMALS_MAX = 9
"""Maximum number of decimals of an error."""
SIDE_BY_SIDE = 3
"""Maximum number of batches in one table of trials: more columns of words are too wide."""
PUBLISHED = "difference from published"
"""Label of the difference from the published result."""
TINY = 1e-6
"""Errors below this share of the arena are tiny, however many times the median they are."""
PAIR = "one - other"
"""The column that names the two batches of a comparison."""


# ---- The summary ----


def summary(comparison: BatchComparison) -> list[Table]:
    """Return the main result of batches: total errors, the verdict, and unusual findings.

    If there are three batches or more, the verdicts have their own table.
    """
    groups = comparison.groups
    first = groups[0]
    errors = _errors(groups, _totals(groups))
    notes: list[str] = []
    if len(groups) <= 2:
        notes += [f"{contrast.name}: {_verdict(contrast)}" for contrast in comparison.contrasts]
    published = first.from_published
    if len(groups) == 1 and published is not None and first.origin.comparable and first.counted:
        notes.append(f"{PUBLISHED}: {published_text(published, first)}")
    notes += _unusual(groups)
    with_notes = replace(errors, note="\n".join(notes))
    if len(groups) <= 2:
        return [with_notes]
    return [with_notes, differences_table(comparison.contrasts)]


def _verdict(contrast: Contrast) -> str:
    """Describe the verdict of a comparison in words, with its difference and test.

    If there is no verdict, the reason is stated instead.
    """
    if contrast.verdict is None:
        verdict = f"no verdict ({contrast.reason})"
    elif contrast.verdict == "undecided":
        verdict = "no significant difference"
    else:
        verdict = f"{contrast.verdict} mean error"
    first = contrast.first
    show = create_length_format(contrast.difference.value, decimals_shown(first.experiment))
    difference = contrast.difference.text(first.unit, show, contrast.p_holm)
    basis = contrast.test_of_means
    if contrast.pairs:  # otherwise the numbers of trials are in the table
        basis += f", {contrast.counted}"
    return f"{verdict}, {difference} ({basis})"


def _unusual(groups: Sequence[BatchStatistics]) -> Iterator[str]:
    """Yield a line for each kind of unusual finding, as `LABEL: NAMES: TEXT; NAMES: TEXT`.

    Each text has the names of the batches it is true for, unless there is only one batch.
    """
    names: dict[tuple[str, str], list[str]] = {}  # by label and text
    for group in groups:
        for label, text, name in _remarks(group, len(groups) > 1):
            names.setdefault((label, text), []).append(name)
    only_batch = [groups[0].name] if len(groups) == 1 else None
    texts: dict[str, list[str]] = {}  # by label
    for (label, text), of_text in names.items():
        named = text if of_text == only_batch else f"{join_listed(of_text)}: {text}"
        texts.setdefault(label, []).append(named)
    for label, of_label in texts.items():
        yield f"{label}: {join_listed(of_label, '; ')}"


def _remarks(group: BatchStatistics, several: bool) -> Iterator[tuple[str, str, str]]:
    """Yield the unusual findings of a batch, in short form if it is one of several.

    Each remark has a label, a text, and the name of the batch or trial that it is about.
    """
    for figure in figures_of(group):
        brief = figure.text if figure.brief is None else figure.brief
        text = brief if several else figure.text
        if figure.unusual and text:
            yield figure.label, text, group.name
    logs = flagged(group.batch)
    notes = [", ".join(log.notes) for log in logs]
    stems = [Path(log.log).stem for log in logs]
    if not several:
        for stem, note in zip(stems, notes, strict=True):
            yield "flagged", note, stem
    elif logs:  # the first one: `stats` of this batch alone names them all
        more = f" and {len(logs) - 1} more" if len(logs) > 1 else ""
        yield "flagged", f"{stems[0]} ({notes[0]}){more}", group.name


# ---- The figures of a batch ----


GIVEN_DIRECTIONS = "given directions"
"""What tables and figures call a batch in which no controller decided."""


def figures_of(group: BatchStatistics) -> Iterator[Figure]:
    """Yield the lines that a table shows for a batch below its errors, from top to bottom.

    Examples are the plant, the number of valid trials and the number of earlier attempts.
    """
    yield Figure("plant", str(group.origin), unusual=False)
    if group.experiment.directions_given:
        yield Figure(GIVEN_DIRECTIONS, "no controller decided; not ranked with controllers")
    if group.origin is Origin.DISTURBED:
        # the title of several batches says so
        yield Figure("disturbances", "assumed in the spec, not measured", brief="")
    valid = f"{group.counted} of {len(group.batch.trials)}"
    yield Figure("valid trials", valid, unusual=False)
    yield _tail(group)
    if group.counted and group.from_published is not None:
        text = published_text(group.from_published, group)
        yield Figure(PUBLISHED, text, unusual=False)
    yield from (figure for figure in group.figures if figure.label)
    lost = len(group.batch.lost)
    yield Figure("earlier attempts, excluded", str(group.attempts), unusual=group.attempts > 0)
    yield Figure("logs that cannot be read", str(lost), unusual=lost > 0)


def texts_by_label(group: BatchStatistics) -> dict[str, str]:
    """Return {label: text} of the formatted figures of a batch, in their order."""
    return {figure.label: figure.text for figure in figures_of(group)}


def _tail(group: BatchStatistics) -> Figure:
    """Describe in words how many errors are far above the others, as "2 of 100 above 85.0 mm".

    It is marked as unusual if there is such an error, unless all errors are tiny.
    """
    arena = group.experiment.arena
    tail = group.total.tail
    tiny = group.total.max < TINY * max(arena.width, arena.height)
    text = tail.text(group.unit)
    return Figure(tail.label, text, unusual=tail.above > 0 and not tiny)


def published_text(difference: MeanDifference, group: BatchStatistics) -> str:
    """Describe the difference of a batch's mean error from the published mean error.

    A batch that does not come from real robots is not compared.
    """
    if not group.origin.comparable:
        return f"{UNKNOWN_TEXT} (not real robots)"
    text = difference.text(group.unit, create_length_format(difference.value), difference.p_value)
    return f"{text} (Welch's t)"


# ---- Every table ----


def tables(comparison: BatchComparison) -> list[Table]:
    """Return every table: errors, how the trials ended, comparisons, flagged trials.

    Tables without a row are left out.
    """
    groups = comparison.groups
    parts = [groups[i : i + SIDE_BY_SIDE] for i in range(0, len(groups), SIDE_BY_SIDE)]
    trials = [_trials(part, alone=len(groups) == 1) for part in parts]
    named = _totals(groups)
    if len(groups) == 1:
        named += zip(groups[0].experiment.setup.names, groups[0].robots, strict=True)
    errors = _errors(groups, named)
    candidates = [errors, *trials]
    if comparison.contrasts:
        candidates += [differences_table(comparison.contrasts), _basis(comparison.contrasts)]
    candidates.append(_flagged(groups))
    return [table for table in candidates if len(table)]


def _trials(groups: Sequence[BatchStatistics], alone: bool) -> Table:
    """Return a table about trials: a row for each statistic, and a column for each batch.

    An entry is None if the batch does not have the statistic.
    """
    texts = [texts_by_label(group) for group in groups]
    labels = list(dict.fromkeys(label for of_batch in texts for label in of_batch))
    columns = [Column("figure", labels)]
    for group, of_batch in zip(groups, texts, strict=True):
        name = "value" if alone else group.name
        columns.append(Column(name, [of_batch.get(label) for label in labels], words=True))
    return Table("Trials", tuple(columns))


def _flagged(groups: Sequence[BatchStatistics]) -> Table:
    """Return the table of flagged logs.

    It lists at most LISTED_MAX of them. A last row has the number of the others.
    """
    logs = [log for group in groups for log in flagged(group.batch)]
    rows = [(log.log, log.outcome, ", ".join(log.notes)) for log in logs[:LISTED_MAX]]
    if len(logs) > LISTED_MAX:
        rows.append((f"{len(logs) - LISTED_MAX} more", UNKNOWN_TEXT, "in --format json"))
    return Table.of_texts("Flagged trials", ("log", "outcome", "note"), rows)


# ---- Errors ----


def error_format(smallest: float, decimals_most: int) -> Callable[[float], str]:
    """Create a format that shows three digits of errors of about `smallest`.

    `smallest` is usually the minimum mean. A value of more than ten times that is shown with three
    digits of its own. No value has more than `decimals_most` decimals.
    """
    format_of_least = create_length_format(smallest, decimals_most)

    def show(value: float) -> str:
        if value > 10 * smallest > 0:
            format_of_value = create_length_format(value, decimals_most)
            return format_of_value(value)
        return format_of_least(value)

    return show


def decimals_shown(experiment: Experiment) -> int:
    """Return the number of decimals that resolves about a millionth of the arena.

    Smaller differences have no meaning.
    """
    extent = max(experiment.arena.width, experiment.arena.height)
    of_a_millionth = 6 - math.floor(math.log10(extent))
    return min(max(of_a_millionth, 0), DECIMALS_MAX)


def error_table(
    title: str,
    named: Sequence[tuple[str, Distribution]],
    unit: str,
    smallest: float | None = None,
    decimals_most: int = DECIMALS_MAX,
) -> Table:
    """Return a table with one row for each distribution of errors.

    Args:
        title: Title of the table.
        named: The distributions with their names.
        unit: Unit of the errors.
        smallest: Mean that determines the format. None for the minimum mean.
        decimals_most: Maximum number of decimals.
    """
    values = [distribution for _, distribution in named]
    if smallest is None:
        smallest = min((value.mean for value in values if value.mean > 0), default=0.0)
    show = error_format(smallest, decimals_most)

    return Table(
        title,
        (
            Column("error", [name for name, _ in named], unit),
            Column("n", [value.n for value in values]),
            Column("mean", [value.mean for value in values], format=show),
            Column("std", [value.std for value in values], format=show),
            Column("median", [value.median for value in values], format=show),
            Column("min", [value.min for value in values], format=show),
            Column("max", [value.max for value in values], format=show),
            Column(
                "95 % interval",
                [value.ci95 for value in values],
                format=lambda interval: interval.text(show),
            ),
        ),
    )


def _errors(groups: Sequence[BatchStatistics], named: Sequence[tuple[str, Distribution]]) -> Table:
    """Return the table of the `named` errors of batches, formatted for the smallest total.

    All batches use the length unit of the first one.
    """
    first = groups[0]
    return error_table(
        _errors_title(groups),
        named,
        first.unit,
        smallest=min((group.total.mean for group in groups if group.counted), default=math.nan),
        decimals_most=decimals_shown(first.experiment),
    )


def _totals(groups: Sequence[BatchStatistics]) -> list[tuple[str, Distribution]]:
    """Return the named total error of each batch, followed by the published errors."""
    if len(groups) == 1:
        return [("total", groups[0].total), *_published(groups)]
    return [*((group.name, group.total) for group in groups), *_published(groups)]


def _published(groups: Sequence[BatchStatistics]) -> Iterator[tuple[str, Distribution]]:
    """Yield each published result once. If results differ, their batches are named.

    Nothing is yielded if no spec states one.
    """
    names: dict[tuple[int, float, float], list[str]] = {}  # of batches, by n, mean and std
    for group in groups:
        published = group.experiment.reference
        if published is not None:
            key = (published.n, published.mean, published.std)
            names.setdefault(key, []).append(group.name)
    for (n, mean, std), of_result in names.items():
        name = "published" if len(names) == 1 else f"published for {join_listed(of_result)}"
        yield name, known_distribution(n, mean, std, Interval.none(""))


def _errors_title(groups: Sequence[BatchStatistics]) -> str:
    first = groups[0]
    if len(groups) == 1:
        valid = f"{first.counted} of {len(first.batch.trials)} trials valid"
        return f"{first.experiment.name}, {first.origin}: final error [{first.unit}], {valid}"
    plants = ", ".join(dict.fromkeys(str(group.origin) for group in groups))
    title = f"Final total errors of {len(groups)} batches, {plants}"
    if any(group.origin is Origin.DISTURBED for group in groups):
        title += " (disturbances assumed)"
    return title


# ---- Comparisons ----


def differences_table(contrasts: Sequence[Contrast]) -> Table:
    """Return a table of the differences between the means of batches, with one row per contrast.

    There must be at least one contrast.
    """
    first = contrasts[0].first
    sizes = [abs(contrast.difference.value) for contrast in contrasts]
    largest = max(filter(math.isfinite, sizes), default=0.0)
    show = create_length_format(largest, decimals_shown(first.experiment))
    title = "Comparison of the mean total errors"
    if any(contrast.same_origin for contrast in contrasts) and len(contrasts) > 1:
        title += f", p corrected for {len(contrasts)} tests"
    values = [contrast.difference.value for contrast in contrasts]
    intervals = [contrast.difference.ci95.text(show) for contrast in contrasts]
    verdicts = [contrast.verdict or f"none: {contrast.reason}" for contrast in contrasts]
    return Table(
        title,
        (
            Column(PAIR, [contrast.name for contrast in contrasts]),
            Column("trials", [contrast.counted for contrast in contrasts], words=True),
            Column("difference", values, first.unit, show),
            Column("95 % interval", intervals),
            Column("p (Holm)", [contrast.p_holm for contrast in contrasts], format=format_p_value),
            Column("verdict on the mean error", verdicts, words=True),
        ),
    )


def _basis(contrasts: Sequence[Contrast]) -> Table:
    """Return the table that shows how batches were compared: tests, power, pairs, other fields.

    It has one row per contrast. "-" stands for what is unknown.
    """
    header = (
        PAIR,
        "tests",
        "p (rank test)",
        "detectable at 80 % power",
        "why not paired",
        "differs in",
    )
    rows = [
        (
            contrast.name,
            contrast.tests if contrast.same_origin else UNKNOWN_TEXT,
            format_p_value(contrast.rank_p_holm),
            f"{create_decimal_format(2)(contrast.detects)} sd"
            if contrast.detects > 0
            else UNKNOWN_TEXT,
            contrast.why_unpaired,
            join_listed(contrast.differs) or "nothing",
        )
        for contrast in contrasts
    ]
    return Table.of_texts("What the comparisons rest on", header, rows)


# ---- Every trial ----


def trials_listed(group: BatchStatistics) -> Table:
    """Return the table of a batch's trials with log, error, duration, steps, safety and outcome.

    Earlier attempts and unreadable logs are left out.
    """
    trials = group.batch.trials
    show = create_length_format(group.total.mean)
    outcomes = dict.fromkeys(trial.outcome for trial in trials)
    return Table(
        "",
        (
            Column("log", [Path(trial.log).name for trial in trials]),
            Column("total error", [t.result.total_error for t in trials], group.unit, show),
            Column(
                "duration", [t.result.duration_s for t in trials], "s", create_decimal_format(2)
            ),
            Column("steps", [trial.result.steps for trial in trials]),
            Column("unsafe", [", ".join(unsafe(trial)) or "no" for trial in trials]),
            Column("outcome", [trial.outcome.value for trial in trials]),
        ),
        "; ".join(f"{outcome.value}: {MEANINGS[outcome]}" for outcome in outcomes),
    )
