"""`tetractl stats`: statistics of a batch, and how two batches compare."""

import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from tetractl.core.errors import Exit, UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tetractl.stats.arms import Arms
    from tetractl.stats.comparison import Comparison
    from tetractl.stats.summary import Summary

Format = Literal["table", "json", "csv", "markdown", "latex"]


def stats(
    paths: Annotated[
        list[str],
        typer.Argument(
            metavar="PATH",
            help="Logs, folders or globs: one batch. Several folders, or the folder of a study, are"
            " several batches.",
        ),
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

    Of several folders every two are compared, by their names: paired where the worlds match, with
    tests corrected for their number. Of a study's trials without logs the rows are read.

    Trials that were aborted or interrupted are listed and counted, but stay out of the means; so
    are attempts that --resume set aside.
    Exits with 1 where a log is damaged.

    Example: tetractl stats logs/exact --against logs/euler --plot comparison.pdf

    Example: tetractl stats logs/exact logs/arc logs/euler --plot ecdf.pdf

    Example: tetractl stats logs/slip
    """

    if plot:
        from tetractl.view.style import file_format

        file_format(plot)  # before the logs are read
    form = "json" if as_json else form
    arms = {path: _arms_in(path) for path in (*paths, *(against or ()))}
    if len(paths) == 1 and not against and arms[paths[0]]:
        return _several(arms[paths[0]], form, plot)
    for path, found in arms.items():
        if found:
            raise UsageError(f"{path}: is the folder of a study", "name the folders of its arms")
    if not against and len(paths) > 1 and all(Path(path).is_dir() for path in paths):
        return _several(paths, form, plot)
    return _one(paths, against, form, plot)


def _arms_in(folder: str) -> list[str]:
    """Return the folders of the arms where a folder is a study's, with nothing else in it."""
    from tetractl.log.read.find import find_logs, find_rows

    place = Path(folder)
    arms = [rows.parent for rows in find_rows(place)] if place.is_dir() else []
    if len(arms) < 2 or any(arm.parent != place for arm in arms):
        return []
    logs = find_logs([place], attempts=True, bare=[place])
    return [str(arm) for arm in arms] if {log.parent for log in logs} <= set(arms) else []


def _one(paths: list[str], against: list[str] | None, form: Format, plot: Path | None) -> int:
    """Print one batch, and how it compares with another."""
    from tetractl.stats.comparison import compare

    ours = _summary(paths)
    theirs = _summary(against) if against else None
    comparison = compare(ours, theirs) if theirs else None
    _show(form, ours, comparison)
    if plot:
        from tetractl.view.figures.batch import batch_figure
        from tetractl.view.style import save

        save(batch_figure(ours, comparison), plot)
        print(f"wrote {plot}", file=sys.stderr)
    whole = all(batch.whole for batch in (ours, theirs) if batch)
    return Exit.DONE if whole else Exit.FAILED


def _several(folders: list[str], form: Format, plot: Path | None) -> int:
    """Print how the batches in several folders compare, each called by its folder."""
    from tetractl.stats.arms import Arm, compare_arms

    names = [Path(folder).resolve().name for folder in folders]
    if len(set(names)) < len(names):
        names = folders
    found = compare_arms(
        [Arm(name, _summary([folder])) for name, folder in zip(names, folders, strict=True)]
    )
    _show_arms(form, found)
    if plot:
        from tetractl.view.figures.ecdf import distributions_figure
        from tetractl.view.style import save

        save(distributions_figure(found), plot)
        print(f"wrote {plot}", file=sys.stderr)
    return Exit.DONE if all(arm.summary.whole for arm in found.arms) else Exit.FAILED


def _summary(paths: list[str]) -> "Summary":
    from tetractl.core.errors import LogError
    from tetractl.core.text import printable
    from tetractl.stats.summary import summarise
    from tetractl.stats.trials import load_trials, split_attempts

    with _progress() as on_log:
        trials, damaged = load_trials(paths, on_log, rows=True)
    for trial in split_attempts(trials)[0]:
        if trial.recovered:
            print(f"damaged: {printable(trial.path)}: read as far as possible", file=sys.stderr)
    for log in damaged:
        if not log.set_aside:
            print(f"damaged: {printable(log.path)}: {printable(log.problem)}", file=sys.stderr)
    if not trials:
        raise LogError(f"{' '.join(paths)}: none of {len(damaged)} logs can be read")
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


def _show_arms(form: Format, arms: "Arms") -> None:
    import json

    from rich.console import Console

    from tetractl.stats import arms_export, latex, table
    from tetractl.stats.arms_rows import arms_grids

    match form:
        case "table":
            table.print_grids(arms_grids(arms), Console())
        case "json":
            print(json.dumps(arms_export.arms_json(arms), indent=2, allow_nan=False))
        case "csv":
            print(arms_export.arms_csv(arms), end="")
        case "markdown":
            print(table.grids_markdown(arms_grids(arms)))
        case "latex":
            print(latex.grids_latex(arms_grids(arms)))
