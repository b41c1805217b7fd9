"""`tetractl stats`: statistics of a batch, and how two batches compare."""

import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from tetractl.core.errors import Exit

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tetractl.stats.comparison import Comparison
    from tetractl.stats.summary import Summary

Format = Literal["table", "json", "csv", "markdown", "latex"]


def stats(
    paths: Annotated[
        list[str], typer.Argument(metavar="PATH", help="Logs, folders or globs: one batch.")
    ],
    form: Annotated[Format, typer.Option("--format", help="How to print.")] = "table",
    as_json: Annotated[bool, typer.Option("--json", help="The same as --format json.")] = False,
    against: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATH",
            help="Log, folder or quoted glob of another batch to compare with; may be repeated.",
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Draw the batch too, as .png, .svg or .pdf."),
    ] = None,
) -> int:
    """Print statistics of a batch: errors with intervals, the published result beside them.

    Trials that were aborted or interrupted are listed and counted, but stay out of the means; so
    are attempts that --resume set aside.
    Exits with 1 where a log is damaged.

    Example: tetractl stats logs/exact --against logs/euler --plot comparison.pdf
    """
    from tetractl.stats.comparison import compare

    if plot:
        from tetractl.view.style import file_format

        file_format(plot)  # before the logs are read
    ours = _summary(paths)
    theirs = _summary(against) if against else None
    comparison = compare(ours, theirs) if theirs else None
    _show("json" if as_json else form, ours, comparison)
    if plot:
        from tetractl.view.figures.batch import batch_figure
        from tetractl.view.style import save

        save(batch_figure(ours, comparison), plot)
        print(f"wrote {plot}", file=sys.stderr)
    whole = all(batch.whole for batch in (ours, theirs) if batch)
    return Exit.DONE if whole else Exit.FAILED


def _summary(paths: list[str]) -> "Summary":
    from tetractl.core.errors import LogError
    from tetractl.core.text import printable
    from tetractl.stats.summary import summarise
    from tetractl.stats.trials import load_trials, split_attempts

    with _progress() as on_log:
        trials, damaged = load_trials(paths, on_log)
    for trial in split_attempts(trials)[0]:
        if trial.recovered:
            print(f"damaged: {printable(trial.path)}: read as far as possible", file=sys.stderr)
    for log in damaged:
        if not log.set_aside:
            print(f"damaged: {printable(log.path)}: {printable(log.problem)}", file=sys.stderr)
    if not trials:
        raise LogError(f"none of {len(damaged)} logs can be read")
    return summarise(trials, damaged)


@contextmanager
def _progress() -> "Iterator[Callable[[int, int], object]]":
    """Show a bar on a terminal; yields what to call with the numbers of logs read and of all."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("Reading logs")
        yield lambda done, count: bar.update(task, completed=done, total=count)


def _show(form: Format, summary: "Summary", comparison: "Comparison | None") -> None:
    import json

    from rich.console import Console

    from tetractl.stats import export, latex, table

    match form:
        case "table":
            table.print_table(summary, Console(), comparison)
        case "json":
            print(json.dumps(export.as_json(summary, comparison), indent=2, allow_nan=False))
        case "csv":
            print(export.as_csv(summary, comparison), end="")
        case "markdown":
            print(table.as_markdown(summary, comparison))
        case "latex":
            print(latex.as_latex(summary, comparison))
