"""Shared by several commands: options, loading of specs and logs, warnings, and a confirmation
before robots move.
"""

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from tetractl.core.errors import UsageError

if TYPE_CHECKING:
    from tetractl.experiment.load import LoadedSpec
    from tetractl.log.read.trial_log import TrialLog
    from tetractl.run.plausibility import PlacedWarning

Spec = Annotated[Path, typer.Argument(metavar="SPEC", help="The experiment, a YAML file.")]
Log = Annotated[Path, typer.Argument(metavar="LOG", help="The log of the trial.")]
Logs = Annotated[
    list[Path],
    typer.Argument(metavar="LOG|FOLDER...", help="Trial logs: files, folders or globs."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
Sets = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="PATH=VALUE",
        help="Replace a value of the spec, as field=value; may be repeated.",
    ),
]
Yes = Annotated[
    bool,
    typer.Option("--yes", help="Move robots without asking; needed if there is no terminal."),
]
Strict = Annotated[bool, typer.Option("--strict", help="Exit with code 2 if a spec has warnings.")]


def load(path: Path, sets: Sequence[str]) -> "LoadedSpec":
    """Load a spec by its path, with `--set` applied."""
    from tetractl.experiment.load import load_spec

    return load_spec(path, sets)


def warn(loaded: "LoadedSpec", sets: Sequence[str]) -> "tuple[PlacedWarning, ...]":
    """Print the warnings of a spec that was loaded with `sets`, and return them."""
    from tetractl.run.plausibility import find_warnings

    found = find_warnings(loaded, sets)
    for warning in found:
        print(f"warning: {warning}", file=sys.stderr)
    return found


def open_trial(path: Path) -> "TrialLog":
    """Return the trial of a log; print its damage on stderr."""
    from tetractl.log.read.reader import read_trial

    log = read_trial(path)
    warn_of_damage(log)
    return log


def warn_of_damage(log: "TrialLog") -> None:
    """Print a damaged log's problems and losses to stderr."""
    from tetractl.core.errors import printable

    if log.damage:
        for problem in log.damage.problems:
            print(printable(f"damaged: {log.path}: {problem}"), file=sys.stderr)
        for lost in log.damage.lost:
            print(printable(f"lost: {log.path}: {lost}"), file=sys.stderr)


def refuse(found: "Sequence[PlacedWarning]") -> None:
    """Raise UsageError if a spec has warnings; called with `--strict`."""
    if found:
        count = "a warning" if len(found) == 1 else f"{len(found)} warnings"
        raise UsageError(
            f"the spec has {count}, and --strict treats warnings as errors; nothing was run"
        )


LabChoice = Annotated[
    Literal["lab", "emulated"],
    typer.Option(
        "--plant", help="lab: the spec's lab. emulated: emulate that lab in virtual time."
    ),
]


def require_confirmation(yes: bool) -> None:
    """Raise UsageError if there is neither `yes` nor a terminal at which to confirm that robots may
    move."""
    if not yes and (sys.stdin is None or not sys.stdin.isatty()):
        raise UsageError(
            "robots would move, and there is no terminal at which to ask",
            "add --yes to move them without asking",
        )


def refuse_existing(out: Path | None) -> None:
    """Raise UsageError if the output file exists already."""
    if out is not None and out.exists():
        raise UsageError(f"{out}: exists already", "name another with --out")


@contextmanager
def progress(what: str) -> "Iterator[Callable[[int, int | None], None]]":
    """Show a progress bar on a terminal; yields the function that updates it, called with the
    number done and the total.
    """
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(what, total=None)

        def advance(done: int, count: int | None) -> None:
            bar.update(task, completed=done, total=count)

        yield advance


def announce_compiling(quiet: bool, text: str) -> None:
    """Print on stderr that code is being compiled; with `quiet`, only if stderr is a terminal."""
    if not quiet or sys.stderr.isatty():
        print(text, file=sys.stderr, flush=True)
