"""Create tables of batches and their comparisons, which `stats` and the report page show.

    summary         the tables of `stats` and of the end of a run: errors, verdict, unusual findings
    tables          every table, for `stats --full`
    trials_listed   a table with a row for each trial of a batch, for the report page and notebooks

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
from tetractl.statistics.flagged import flagged, unsafe_robots
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
COLUMNS_MAX = 3
"""Maximum number of batches in one table of trials. A table with more columns is too wide."""
PUBLISHED_LABEL = "difference from published"
"""Label of the difference from the published result."""
TINY_FRACTION = 1e-6
"""Errors below this fraction of the arena are not unusual, even if far above the median."""
PAIR_COLUMN = "one - other"
"""Label of the column that names the two batches of a comparison."""


# ---- The summary ----


def summary(comparison: BatchComparison) -> list[Table]:
    """Create the tables of the main result: total errors, the verdict, and unusual findings.

    If there are three batches or more, the verdicts have their own table.
    """
    groups = comparison.groups
    first_group = groups[0]
    errors = _errors_table(groups, _total_errors(groups))
    notes: list[str] = []
    if len(groups) <= 2:
        notes += [
            f"{contrast.name}: {_describe_verdict(contrast)}" for contrast in comparison.contrasts
        ]
    published = first_group.from_published
    if (
        len(groups) == 1
        and published is not None
        and first_group.origin.comparable
        and first_group.counted
    ):
        notes.append(f"{PUBLISHED_LABEL}: {describe_published_difference(published, first_group)}")
    notes += _unusual_lines(groups)
    with_notes = replace(errors, note="\n".join(notes))
    if len(groups) <= 2:
        return [with_notes]
    return [with_notes, differences_table(comparison.contrasts)]


def _describe_verdict(contrast: Contrast) -> str:
    """Describe the verdict of a comparison in words, with its difference and test.

    If there is no verdict, the text says why.
    """
    if contrast.verdict is None:
        verdict = f"no verdict ({contrast.reason})"
    elif contrast.verdict == "undecided":
        verdict = "no significant difference"
    else:
        verdict = f"{contrast.verdict} mean error"
    first = contrast.first
    format_difference = create_length_format(
        contrast.difference.value, decimals_shown(first.experiment)
    )
    difference = contrast.difference.text(first.unit, format_difference, contrast.p_holm)
    basis = contrast.test_of_means
    if contrast.pairs:  # otherwise the numbers of trials are in the table
        basis += f", {contrast.counted}"
    return f"{verdict}, {difference} ({basis})"


def _unusual_lines(groups: Sequence[BatchStatistics]) -> Iterator[str]:
    """Yield a line for each kind of unusual finding, as `LABEL: NAMES: TEXT; NAMES: TEXT`.

    Each text names the batches that it applies to, unless there is only one batch.
    """
    names_of_remark: dict[tuple[str, str], list[str]] = {}  # by label and text
    for group in groups:
        for label, text, name in _unusual_remarks(group, len(groups) > 1):
            names_of_remark.setdefault((label, text), []).append(name)
    only_batch = [groups[0].name] if len(groups) == 1 else None
    remarks: dict[str, list[str]] = {}  # by label
    for (label, text), names in names_of_remark.items():
        remark = text if names == only_batch else f"{join_listed(names)}: {text}"
        remarks.setdefault(label, []).append(remark)
    for label, texts in remarks.items():
        yield f"{label}: {join_listed(texts, '; ')}"


def _unusual_remarks(
    group: BatchStatistics, is_one_of_several: bool
) -> Iterator[tuple[str, str, str]]:
    """Yield the unusual findings of a batch.

    Args:
        group: The batch.
        is_one_of_several: Whether there are several batches. Then the short form is used.

    Yields:
        The label and the text of a finding, and the name of the batch or trial that it is about.
    """
    for figure in figure_lines(group):
        brief = figure.text if figure.brief is None else figure.brief
        text = brief if is_one_of_several else figure.text
        if figure.unusual and text:
            yield figure.label, text, group.name
    logs = flagged(group.batch)
    notes = [", ".join(log.notes) for log in logs]
    stems = [Path(log.log).stem for log in logs]
    if not is_one_of_several:
        for stem, note in zip(stems, notes, strict=True):
            yield "flagged", note, stem
    elif logs:  # the first one: `stats` of this batch alone names them all
        addition = f" and {len(logs) - 1} more" if len(logs) > 1 else ""
        yield "flagged", f"{stems[0]} ({notes[0]}){addition}", group.name


# ---- The figures of a batch ----


GIVEN_DIRECTIONS = "given directions"
"""Label in tables and figures for a batch in which no controller decided."""


def figure_lines(group: BatchStatistics) -> Iterator[Figure]:
    """Yield the lines that a table shows for a batch below its errors, from top to bottom.

    Examples are the plant, the number of valid trials and the number of earlier attempts.
    """
    yield Figure("plant", str(group.origin), unusual=False)
    if group.experiment.gives_directions:
        yield Figure(GIVEN_DIRECTIONS, "no controller was used, so the batch is not ranked")
    if group.origin is Origin.DISTURBED:
        # the title of several batches says so
        yield Figure("disturbances", "assumed in the spec, not measured", brief="")
    valid = f"{group.counted} of {len(group.batch.trials)}"
    yield Figure("valid trials", valid, unusual=False)
    yield _tail_figure(group)
    if group.counted and group.from_published is not None:
        text = describe_published_difference(group.from_published, group)
        yield Figure(PUBLISHED_LABEL, text, unusual=False)
    yield from (figure for figure in group.figures if figure.label)
    unreadable = len(group.batch.lost)
    yield Figure("earlier attempts, excluded", str(group.attempts), unusual=group.attempts > 0)
    yield Figure("logs that cannot be read", str(unreadable), unusual=unreadable > 0)


def texts_by_label(group: BatchStatistics) -> dict[str, str]:
    """Return {label: text} of the formatted figures of a batch, in their order."""
    return {figure.label: figure.text for figure in figure_lines(group)}


def _tail_figure(group: BatchStatistics) -> Figure:
    """Describe in words how many errors are far above the others, as "2 of 100 above 85.0 mm".

    The figure is marked as unusual if there is such an error, unless all errors are tiny.
    """
    arena = group.experiment.arena
    tail = group.total.tail
    are_tiny = group.total.max < TINY_FRACTION * max(arena.width, arena.height)
    text = tail.text(group.unit)
    return Figure(tail.label, text, unusual=tail.above > 0 and not are_tiny)


def describe_published_difference(difference: MeanDifference, group: BatchStatistics) -> str:
    """Describe the difference of a batch's mean error from the published mean error.

    A batch that does not come from real robots is not compared.
    """
    if not group.origin.comparable:
        return f"{UNKNOWN_TEXT} (not real robots)"
    text = difference.text(group.unit, create_length_format(difference.value), difference.p_value)
    return f"{text} (Welch's t)"


# ---- Every table ----


def tables(comparison: BatchComparison) -> list[Table]:
    """Create all tables: errors, how the trials ended, comparisons, and flagged trials.

    Tables without a row are left out.
    """
    groups = comparison.groups
    group_chunks = [groups[i : i + COLUMNS_MAX] for i in range(0, len(groups), COLUMNS_MAX)]
    trial_tables = [_trials_table(chunk, is_only_batch=len(groups) == 1) for chunk in group_chunks]
    distributions = _total_errors(groups)
    if len(groups) == 1:
        distributions += zip(groups[0].experiment.setup.names, groups[0].robots, strict=True)
    errors = _errors_table(groups, distributions)
    candidates = [errors, *trial_tables]
    if comparison.contrasts:
        candidates += [differences_table(comparison.contrasts), _basis_table(comparison.contrasts)]
    candidates.append(_flagged_table(groups))
    return [table for table in candidates if len(table)]


def _trials_table(groups: Sequence[BatchStatistics], is_only_batch: bool) -> Table:
    """Create the table of statistics of trials: a row for each figure, a column for each batch.

    An entry is None if the batch does not have the figure.
    """
    texts = [texts_by_label(group) for group in groups]
    labels = list(dict.fromkeys(label for text_by_label in texts for label in text_by_label))
    columns = [Column("figure", labels)]
    for group, text_by_label in zip(groups, texts, strict=True):
        name = "value" if is_only_batch else group.name
        columns.append(Column(name, [text_by_label.get(label) for label in labels], words=True))
    return Table("Trials", tuple(columns))


def _flagged_table(groups: Sequence[BatchStatistics]) -> Table:
    """Create the table of flagged logs.

    It lists at most LISTED_MAX logs. If there are more, a last row has their number.
    """
    logs = [log for group in groups for log in flagged(group.batch)]
    rows = [(log.log, log.outcome, ", ".join(log.notes)) for log in logs[:LISTED_MAX]]
    if len(logs) > LISTED_MAX:
        rows.append((f"{len(logs) - LISTED_MAX} more", UNKNOWN_TEXT, "in --format json"))
    return Table.of_texts("Flagged trials", ("log", "outcome", "note"), rows)


# ---- Errors ----


def error_format(smallest: float, decimals_max: int) -> Callable[[float], str]:
    """Create a function that formats errors with about three digits.

    Args:
        smallest: Size of the smallest errors, usually the minimum mean. Errors of up to ten times
            this size have the same number of decimals. Larger ones have three digits of their own.
        decimals_max: Maximum number of decimals.
    """
    format_smallest = create_length_format(smallest, decimals_max)

    def format_error(value: float) -> str:
        if value > 10 * smallest > 0:
            format_of_value = create_length_format(value, decimals_max)
            return format_of_value(value)
        return format_smallest(value)

    return format_error


def decimals_shown(experiment: Experiment) -> int:
    """Compute the number of decimals that resolves about a millionth of the arena's extent.

    Smaller differences have no meaning.
    """
    extent = max(experiment.arena.width, experiment.arena.height)
    millionth_decimals = 6 - math.floor(math.log10(extent))
    return min(max(millionth_decimals, 0), DECIMALS_MAX)


def error_table(
    title: str,
    named_errors: Sequence[tuple[str, Distribution]],
    unit: str,
    smallest: float | None = None,
    decimals_max: int = DECIMALS_MAX,
) -> Table:
    """Create a table with one row for each distribution of errors.

    Args:
        title: Title of the table.
        named_errors: The distributions with their names.
        unit: Unit of the errors.
        smallest: Mean that determines the format. None for the minimum mean.
        decimals_max: Maximum number of decimals.
    """
    errors = [distribution for _, distribution in named_errors]
    if smallest is None:
        smallest = min((value.mean for value in errors if value.mean > 0), default=0.0)
    format_error = error_format(smallest, decimals_max)

    return Table(
        title,
        (
            Column("error", [name for name, _ in named_errors], unit),
            Column("n", [value.n for value in errors]),
            Column("mean", [value.mean for value in errors], format=format_error),
            Column("std", [value.std for value in errors], format=format_error),
            Column("median", [value.median for value in errors], format=format_error),
            Column("min", [value.min for value in errors], format=format_error),
            Column("max", [value.max for value in errors], format=format_error),
            Column(
                "95 % interval",
                [value.ci95 for value in errors],
                format=lambda interval: interval.text(format_error),
            ),
        ),
    )


def _errors_table(
    groups: Sequence[BatchStatistics], named_errors: Sequence[tuple[str, Distribution]]
) -> Table:
    """Create the table of the errors of batches, in a format that suits the smallest total error.

    Args:
        groups: The batches. All of them use the length unit of the first batch.
        named_errors: The distributions of errors, each with a name.
    """
    first_group = groups[0]
    return error_table(
        _errors_title(groups),
        named_errors,
        first_group.unit,
        smallest=min((group.total.mean for group in groups if group.counted), default=math.nan),
        decimals_max=decimals_shown(first_group.experiment),
    )


def _total_errors(groups: Sequence[BatchStatistics]) -> list[tuple[str, Distribution]]:
    """List the total errors of each batch, followed by the published errors, each with a name."""
    if len(groups) == 1:
        return [("total", groups[0].total), *_published_errors(groups)]
    return [*((group.name, group.total) for group in groups), *_published_errors(groups)]


def _published_errors(groups: Sequence[BatchStatistics]) -> Iterator[tuple[str, Distribution]]:
    """Yield each published result that a spec states once, with a name for its row.

    If results differ, the names list the batches that each result belongs to.
    """
    names: dict[tuple[int, float, float], list[str]] = {}  # of batches, by n, mean and std
    for group in groups:
        published = group.experiment.reference
        if published is not None:
            key = (published.n, published.mean, published.std)
            names.setdefault(key, []).append(group.name)
    for (n, mean, std), batches in names.items():
        name = "published" if len(names) == 1 else f"published for {join_listed(batches)}"
        yield name, known_distribution(n, mean, std, Interval.none(""))


def _errors_title(groups: Sequence[BatchStatistics]) -> str:
    first_group = groups[0]
    if len(groups) == 1:
        valid = f"{first_group.counted} of {len(first_group.batch.trials)} trials valid"
        name = first_group.experiment.name
        return f"{name}, {first_group.origin}: final error [{first_group.unit}], {valid}"
    plants = ", ".join(dict.fromkeys(str(group.origin) for group in groups))
    title = f"Final total errors of {len(groups)} batches, {plants}"
    if any(group.origin is Origin.DISTURBED for group in groups):
        title += " (disturbances assumed)"
    return title


# ---- Comparisons ----


def differences_table(contrasts: Sequence[Contrast]) -> Table:
    """Create the table of the differences between the means of batches, with a row per contrast.

    There must be at least one contrast.
    """
    first = contrasts[0].first
    magnitudes = [abs(contrast.difference.value) for contrast in contrasts]
    largest = max(filter(math.isfinite, magnitudes), default=0.0)
    format_difference = create_length_format(largest, decimals_shown(first.experiment))
    title = "Comparison of the mean total errors"
    if any(contrast.same_origin for contrast in contrasts) and len(contrasts) > 1:
        title += f", p corrected for {len(contrasts)} tests"
    values = [contrast.difference.value for contrast in contrasts]
    intervals = [contrast.difference.ci95.text(format_difference) for contrast in contrasts]
    verdicts = [contrast.verdict or f"none: {contrast.reason}" for contrast in contrasts]
    return Table(
        title,
        (
            Column(PAIR_COLUMN, [contrast.name for contrast in contrasts]),
            Column("trials", [contrast.counted for contrast in contrasts], words=True),
            Column("difference", values, first.unit, format_difference),
            Column("95 % interval", intervals),
            Column("p (Holm)", [contrast.p_holm for contrast in contrasts], format=format_p_value),
            Column("verdict on the mean error", verdicts, words=True),
        ),
    )


def _basis_table(contrasts: Sequence[Contrast]) -> Table:
    """Create the table that shows how batches were compared: tests, power, pairs, other fields.

    It has one row per contrast. "-" stands for an unknown value.
    """
    header = (
        PAIR_COLUMN,
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
    return Table.of_texts("Methods of the comparisons", header, rows)


# ---- Every trial ----


def trials_listed(group: BatchStatistics) -> Table:
    """Create the table of a batch's trials: log, error, duration, steps, safety and outcome.

    Earlier attempts and unreadable logs are left out.
    """
    trials = group.batch.trials
    format_error = create_length_format(group.total.mean)
    outcomes = dict.fromkeys(trial.outcome for trial in trials)
    return Table(
        "",
        (
            Column("log", [Path(trial.log).name for trial in trials]),
            Column("total error", [t.result.total_error for t in trials], group.unit, format_error),
            Column(
                "duration", [t.result.duration_s for t in trials], "s", create_decimal_format(2)
            ),
            Column("steps", [trial.result.steps for trial in trials]),
            Column("unsafe", [", ".join(unsafe_robots(trial)) or "no" for trial in trials]),
            Column("outcome", [trial.outcome.value for trial in trials]),
        ),
        "; ".join(f"{outcome.value}: {MEANINGS[outcome]}" for outcome in outcomes),
    )
