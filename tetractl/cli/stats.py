"""`tetractl stats`: prints statistics of batches, and comparisons between them."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from tetractl.cli.options import progress
from tetractl.core.errors import Exit

if TYPE_CHECKING:
    from tetractl.results.contrast import GroupComparison
    from tetractl.results.describe import Group
    from tetractl.results.open_batch import Source

Format = Literal["table", "json", "csv", "markdown", "latex", "html"]


def stats(
    paths: Annotated[
        list[str],
        typer.Argument(
            metavar="PATH",
            help="Logs, folders or globs: one batch. Several folders, or one of several"
            " folders such as a study, are several batches.",
        ),
    ],
    form: Annotated[Format, typer.Option("--format", help="Output format.")] = "table",
    as_json: Annotated[bool, typer.Option("--json", help="The same as --format json.")] = False,
    against: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATH",
            help="Log, folder or quoted glob of a baseline batch: the others are compared "
            "with this batch only; may be repeated.",
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="File of a figure of the batches: .png, .svg or .pdf."),
    ] = None,
) -> int:
    """Print statistics of batches: errors with intervals, the published result, comparisons.

    Every two batches are compared, or each with the baseline of --against: paired if their seeds
    match, with tests corrected for the number of comparisons. A study's trials without logs are
    read from its rows.

    Trials that were aborted or interrupted, and attempts that --resume set aside, are listed and
    counted but left out of the means. Exits with 1 if a log is damaged.

    Example: tetractl stats logs/exact --against logs/euler --plot comparison.pdf

    Example: tetractl stats logs/exact logs/arc logs/euler --plot ecdf.pdf

    Example: tetractl stats logs/slip
    """
    from tetractl.results.contrast import contrast
    from tetractl.results.open_batch import one_source, sources

    if plot:
        from tetractl.view.style import file_format

        file_format(plot)  # checked before the logs are read
    listed = [*sources(paths), *([one_source(against)] if against else [])]
    groups = _described(listed)
    found = contrast(groups[:-1], groups[-1]) if against else contrast(groups)
    show(found, "json" if as_json else form)
    if plot:
        _draw(found, plot)
    return Exit.DONE if found.whole else Exit.FAILED


def show(found: "GroupComparison", form: str) -> None:
    """Print groups and their comparisons to stdout."""
    from tetractl.core.table.table_files import csv_text, json_text
    from tetractl.core.table.terminal_table import TEXTS, print_tables
    from tetractl.results.tables import data_table, tables

    if form == "table":
        print_tables(tables(found))
    elif form == "json":
        print(json_text(found.record), flush=True)
    elif form == "csv":
        print(csv_text(data_table(found)), end="")
    else:
        print(TEXTS[form](tables(found)))


def _described(listed: "Sequence[Source]") -> "list[Group]":
    """Read and describe batches; print damaged logs and rows on stderr."""
    from tetractl.core.errors import LogError, printable
    from tetractl.results.describe import describe

    groups = []
    for source in listed:
        with progress("Reading logs") as on_log:
            batch = source.read(on_log)
        for trial in batch.trials:
            if trial.recovered:
                print(f"damaged: {printable(trial.path)}: read as far as possible", file=sys.stderr)
        for log in batch.lost:
            print(f"damaged: {printable(log.path)}: {printable(log.problem)}", file=sys.stderr)
        if not batch.trials and not batch.attempts:
            raise LogError(f"{source.name}: none of {len(batch.damaged)} logs can be read")
        groups.append(describe(batch, source.name))
    return groups


def _draw(found: "GroupComparison", file: Path) -> None:
    """Draw one or two groups with a dot per trial, or the distributions of more groups."""
    from tetractl.view.figures.batch import batch_figure
    from tetractl.view.figures.ecdf import distributions_figure
    from tetractl.view.style import save

    few = len(found.groups) <= 2
    save(batch_figure(found.groups) if few else distributions_figure(found.groups), file)
    print(f"wrote {file}", file=sys.stderr)
