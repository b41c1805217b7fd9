"""Functions that several commands of the command line share: loading, printing and asking.

They load specs and logs, print messages and results, and ask before robots move.
"""

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from tetractl.core.errors import UsageError, printable
from tetractl.tools.table.table import Table
from tetractl.tools.table.table_files import format_json
from tetractl.tools.table.terminal_table import open_console, print_tables
from tetractl.tools.terminal import has_keys, is_terminal

if TYPE_CHECKING:
    from tetractl.core.protocols import LabSupervision
    from tetractl.lab.rig import Rig
    from tetractl.log.read.trial_log import Damage, TrialLog
    from tetractl.plant.lab_plant import RigSection
    from tetractl.run.plausibility import PlacedWarning
    from tetractl.spec.experiment import Experiment
    from tetractl.spec.loaded_spec import LoadedSpec


# ---- What is read ----


def load_spec_file(path: Path, sets: Sequence[str] | None) -> "LoadedSpec":
    """Load a spec from a file, with the values of `--set` applied."""
    from tetractl.spec.load import load_spec

    return load_spec(path, sets or [])


def print_warnings(loaded: "LoadedSpec", strict: bool = False) -> "tuple[PlacedWarning, ...]":
    """Print the warnings about a spec, and return them.

    Raises:
        UsageError: If there are any, and `strict` is True.
    """
    from tetractl.run.plausibility import find_warnings

    warnings = find_warnings(loaded)
    print_messages(*(f"warning: {warning}" for warning in warnings))
    if strict and warnings:
        count = "a warning" if len(warnings) == 1 else f"{len(warnings)} warnings"
        raise UsageError(
            f"the spec has {count}, and with --strict, warnings are errors; nothing was run"
        )
    return warnings


def open_trial(path: Path) -> "TrialLog":
    """Read the trial of a log, and print the log's damage on stderr."""
    from tetractl.log.read.reader import read_trial

    log = read_trial(path)
    warn_of_damage(log.log, log.damage)
    return log


def warn_of_damage(path: str, damage: "Damage | None") -> None:
    """Print the problems and losses of a damaged log to stderr."""
    if damage:
        print_messages(*(f"damaged: {path}: {problem}" for problem in damage.problems))
        print_messages(*(f"lost: {path}: {loss}" for loss in damage.lost))


# ---- What is printed ----


def print_messages(*lines: str) -> None:
    """Print lines to stderr. Characters that are unsafe for a terminal are escaped."""
    for line in lines:
        print(printable(line), file=sys.stderr, flush=True)


def print_results(as_json: bool, json_object: object, tables: "Sequence[Table]") -> None:
    """Print the results of a command to stdout, as tables or as JSON.

    Args:
        as_json: Whether to print one JSON object instead of tables.
        json_object: The results as data for JSON.
        tables: The results as tables.
    """
    if as_json:
        print(format_json(json_object))
    else:
        print_tables(tables)


@contextmanager
def show_progress(description: str) -> "Iterator[Callable[[int, int | None], None]]":
    """Show a progress bar on a terminal during the `with` block.

    The block gets the function that updates the bar, called with the number done and the total.
    """
    from rich.progress import Progress

    console = open_console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(description, total=None)
        yield lambda done, count: bar.update(task, completed=done, total=count)


def announce_compiling(quiet: bool, text: str) -> None:
    """Print on stderr that code is being compiled. If `quiet`, only where stderr is a terminal."""
    if not quiet or is_terminal(sys.stderr):
        print_messages(text)


# ---- What is written ----


def refuse_existing(path: Path | None) -> None:
    """Check that an output file does not exist yet, and that its folder exists.

    Raises:
        UsageError: If the file exists, or if its folder is missing.
    """
    if path is None:
        return
    if path.exists():
        raise UsageError(f"{path}: exists already", "choose another name with --out")
    require_folder_of(path)


def refuse_filled(folder: Path | None) -> None:
    """Check that an output folder does not exist or is empty.

    Raises:
        UsageError: If it has files.
    """
    if folder is None or not folder.exists():
        return
    if not folder.is_dir() or any(folder.iterdir()):
        raise UsageError(f"{folder}: exists already", "choose another name with --out")


def require_folder_of(path: Path) -> None:
    """Check, before any work is done, that an output file can be written.

    Raises:
        UsageError: If the folder is missing, or if the name belongs to a folder.
    """
    if not path.parent.is_dir():
        raise UsageError(f"{path}: the folder {path.parent} does not exist")
    if path.is_dir():
        raise UsageError(
            f"{path}: this is a folder, but a file is needed", "name a file in this folder"
        )


# ---- Labs, and robots that move ----


def find_rig_section(experiment: "Experiment") -> "RigSection":
    """Return the part of the spec that describes the lab, which must be the experiment's plant."""
    from tetractl.plant.lab_plant import RigSection

    lab = experiment.plant
    if not isinstance(lab, RigSection):
        raise UsageError(
            f"--plant {lab.type}: this plant has no camera and no actuator",
            "choose --plant lab or --plant emulated",
        )
    return lab


def build_rig_of(experiment: "Experiment", supervision: "LabSupervision | None" = None) -> "Rig":
    """Return a lab's rig, its camera and actuator, for a command that runs no trial."""
    from numpy.random import SeedSequence

    lab = find_rig_section(experiment)
    seed = SeedSequence(experiment.trials.seed)
    return lab.rig(
        experiment.setup, lab.clock(), seed, supervision, chosen=experiment.must_choose_robots
    )


def require_yes_or_terminal(yes: bool) -> None:
    """Check that a person can confirm that robots may move, or has done so by --yes.

    Raises:
        UsageError: If there is neither `yes` nor a terminal.
    """
    if not yes and not has_keys():
        raise UsageError(
            "robots would move, and there is no terminal to ask for permission",
            "add --yes to move them without asking",
        )


def require_consent(yes: bool, consequence: str) -> None:
    """Ask the user on stderr whether robots may move, unless `yes` is given.

    Args:
        yes: Whether the user has agreed already.
        consequence: What will happen, as a sentence that precedes the question.

    Raises:
        UsageError: If there is no terminal to ask.
        Abort: If the robots may not move.
    """
    require_yes_or_terminal(yes)
    if not yes:
        typer.confirm(f"{consequence} Continue?", abort=True, err=True)
