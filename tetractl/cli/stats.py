"""The command `tetractl stats`, which summarises the errors of trials and compares batches."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tetractl.cli import ui
from tetractl.cli.options import LikeFormatJson, argument, option, switch
from tetractl.core.errors import Exit, LogError
from tetractl.tools.table.table_files import format_csv, format_json
from tetractl.tools.table.terminal_table import TEXT_FORMATS, print_tables

if TYPE_CHECKING:
    from tetractl.statistics.describe import BatchComparison, BatchStatistics
    from tetractl.statistics.open_batch import Source

Format = Literal["table", "json", "csv", "markdown", "latex", "html"]


def stats(
    paths: Annotated[
        list[str],
        argument(
            "PATH",
            "Logs, folders or glob patterns of one batch. Several folders, or a folder of "
            "folders such as a study, are several batches.",
        ),
    ],
    form: Annotated[
        Format,
        option("FORMAT", "Output format: table, json, csv, markdown, latex or html.", "--format"),
    ] = "table",
    as_json: LikeFormatJson = False,
    against: Annotated[
        list[str] | None,
        option(
            "PATH",
            "Log, folder or quoted glob pattern of a baseline batch. The other batches are "
            "compared only with it. Can be repeated.",
        ),
    ] = None,
    plot: Annotated[
        Path | None, option("FILE", "File to draw a figure of the batches in: .png, .svg or .pdf.")
    ] = None,
    full: Annotated[
        bool,
        switch(
            "Print all figures, including the distances of each robot, the solve times and every "
            "flagged trial.",
            "--full",
        ),
    ] = False,
) -> int:
    """Print the total errors of batches, a comparison of the batches, and unusual trials.

    The command compares every pair of batches, or every batch with the baseline given by --against.
    Trials are paired if their seeds match. The tests are corrected for the number of comparisons.
    If trials of a study have no logs, they are read from its table.

    Trials that were aborted or interrupted, and attempts that --resume replaced, are flagged and
    left out of the means. Exits with 1 if a log is damaged.

    Example: tetractl stats logs/exact --against logs/euler --plot comparison.pdf

    Example: tetractl stats logs/slip
    """
    from tetractl.statistics.describe import contrast
    from tetractl.statistics.open_batch import combine_sources, find_sources

    batches = find_sources(paths)
    if plot:
        from tetractl.view.style import file_format

        file_format(plot)  # checked before the logs are read
    if against:
        *described, baseline = _described([*batches, combine_sources(against)])
        comparison = contrast(described, baseline)
    else:
        comparison = contrast(_described(batches))
    show(comparison, "json" if as_json else form, full)
    if plot:
        from tetractl.view.figures.batch import batch_figure
        from tetractl.view.style import save

        save(batch_figure(comparison.groups), plot)
        ui.print_messages(f"wrote {plot}")
    return Exit.DONE if comparison.whole else Exit.FAILED


def show(comparison: "BatchComparison", form: str, full: bool = False) -> None:
    """Print the statistics of batches, and of their comparisons, to stdout.

    Args:
        comparison: The batches.
        form: The format.
        full: Whether a table is complete, not short.
    """
    from tetractl.statistics.as_json import comparison_items, data_table
    from tetractl.statistics.tables import summary, tables

    tables_of = tables if full else summary
    if form == "table":
        print_tables(tables_of(comparison))
    elif form == "json":
        print(format_json(comparison_items(comparison)), flush=True)
    elif form == "csv":
        print(format_csv(data_table(comparison)), end="")
    else:
        print(TEXT_FORMATS[form](tables_of(comparison)))


def _described(batches: "Sequence[Source]") -> "list[BatchStatistics]":
    """Read batches, and compute their statistics. Damaged logs and rows are reported on stderr."""
    from tetractl.statistics.describe import describe

    described: list[BatchStatistics] = []
    for source in batches:
        with ui.show_progress("Reading logs") as on_log:
            batch = source.read(on_log)
        for trial in batch.trials:
            if trial.recovered:
                ui.print_messages(f"{trial.log} is damaged, and was read as far as possible")
        ui.print_messages(*(f"damaged: {log.log}: {log.problem}" for log in batch.lost))
        if not batch.trials and not batch.attempts:
            raise LogError(f"{source.name}: none of its {len(batch.damaged)} logs can be read")
        described.append(describe(batch, source.name))
    return described
