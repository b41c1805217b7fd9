"""Runs, displays and stops the trials of `run`, `rerun` and other commands that drive a plant."""

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tetractl.cli.options import announce_compiling, require_confirmation
from tetractl.cli.serving import served_run
from tetractl.core.errors import Exit, TetractlError, UsageError, printable

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from tetractl.core.protocols import LabSupervision, Observer
    from tetractl.experiment.experiment import Experiment
    from tetractl.experiment.load import LoadedSpec
    from tetractl.run.batch import Report, TrialStore
    from tetractl.run.interrupt import Interrupt
    from tetractl.run.store import LogStore
    from tetractl.run.task import Task


def run_in_lab(
    tasks: "list[Task]",
    store: "TrialStore",
    unit: str,
    console: "Console",
    interrupt: "Interrupt",
    live: bool,
    yes: bool,
    served: "Sequence[Observer]" = (),
    unattended: bool = False,
) -> "Report":
    """Run trials in the lab; the terminal's space bar and Esc stop the robots at any time.

    A person at the terminal starts each trial, unless `yes`. If `unattended`, the robots are not
    stopped when the terminal closes.
    """
    from rich.console import Console

    from tetractl.core.protocols import LabSupervision
    from tetractl.run.batch import run_batch
    from tetractl.run.executors import Here
    from tetractl.view.terminal.keys import SAYS, StopKey
    from tetractl.view.terminal.live_screen import LabWatch, TerminalPrompt

    quiet, console = console, Console(stderr=True)  # messages on safety are always printed
    emergency, entered = threading.Event(), threading.Event()
    with StopKey(emergency.set, entered.set, unattended) as key:
        says = SAYS if key.listening else "no terminal: there is no key to stop the robots"
        console.print(says, style="bold", highlight=False)
        watch = LabWatch(console, quiet, unit, live and key.listening)
        prompt = None if yes or not key.listening else TerminalPrompt(console, entered)

        @contextmanager
        def supervision(trial: int) -> "Iterator[LabSupervision]":
            yield LabSupervision(emergency, prompt, lambda: interrupt.requested)

        executor = Here(interrupt, [watch, *served], supervision)
        return run_batch(tasks, store, executor, watch, fail_fast=True)


STOPPING = b"\nstopping after this step; a second Ctrl-C stops at once\n"


class PlantChoice(StrEnum):
    """A plant named by --plant: the simulation of a spec, its lab, or its lab emulated."""

    SIM = "sim"
    LAB = "lab"
    EMULATED = "emulated"


Out = Annotated[
    Path | None,
    typer.Option(
        "-o", "--out", metavar="DIR", help="Folder for the logs.  \\[logs/<spec name>-<UTC time>]"
    ),
]
DryRun = Annotated[
    bool,
    typer.Option(
        "--dry-run", help="Run nothing: print the spec, its limits and what would be run."
    ),
]
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", help="Show neither a live view nor progress.")
]
Unattended = Annotated[
    bool,
    typer.Option(
        "--unattended",
        help="Lab only, with --yes: go on if the terminal closes or no process reads the output "
        "any more, which otherwise stops the robots.",
    ),
]
Json = Annotated[
    bool, typer.Option("--json", help="Print the statistics as JSON, like `stats --format json`.")
]


def run_command(
    loaded: "LoadedSpec",
    out: Path | None,
    only: int | None = None,
    *,
    jobs: int = 1,
    resume: bool = False,
    dry_run: bool,
    quiet: bool,
    yes: bool,
    port: int | None,
    json: bool,
    unattended: bool,
) -> tuple[int, Path]:
    """Run the trials of a spec, or only trial `only`, and print the statistics; with `dry_run`,
    only print the spec.

    Return the exit code and the logs' folder. Trials are served at `port`, unless it is None.
    """
    from rich.console import Console

    from tetractl.run.store import LogStore, default_folder
    from tetractl.run.trial_limits import check

    experiment = loaded.experiment
    in_lab = experiment.plant.real_time
    if in_lab and jobs > 1:
        raise UsageError("--jobs is for virtual time: the lab runs one trial at a time")
    if unattended and not (in_lab and yes):
        raise UsageError("--unattended is only for robots in the lab", "add --plant lab --yes")
    check(experiment)
    folder = out or default_folder(experiment.name, datetime.now(UTC))
    store = LogStore(folder, experiment)
    if dry_run:
        todo = store.lacking(resume)
        _describe(loaded, folder, todo if only is None else [only])
        return Exit.DONE, folder
    if in_lab:
        require_confirmation(yes)
    console = Console(stderr=True, quiet=quiet)
    with (
        served_run(experiment.name, port) as served,
        store.opened(resume) as todo,
        stoppable(experiment, console, unattended) as interrupt,
    ):
        todo = todo if only is None else [only]
        report = run_trials(loaded, store, todo, jobs, console, interrupt, yes, served, unattended)
        return _conclude(report, todo, folder, interrupt.requested, json), folder


def drive(loaded: "LoadedSpec", folder: Path, trial: int, yes: bool) -> Path:
    """Run a trial, write its log to a folder, and return the path of the log.

    In the lab, robots move only once the operator has agreed, or with `yes`, and once all checks of
    a run have passed; the space bar and Esc stop them. Raises TetractlError for a trial that was
    aborted, KeyboardInterrupt for one that was interrupted.
    """
    from rich.console import Console

    from tetractl.core.plan import Outcome
    from tetractl.run.store import LogStore
    from tetractl.run.task import log_path
    from tetractl.run.trial_limits import check

    check(loaded.experiment)
    in_lab = loaded.experiment.plant.real_time
    if in_lab:
        require_confirmation(yes)
    console, store = Console(stderr=True, quiet=not in_lab), LogStore(folder, loaded.experiment)
    with store.opened(False), stoppable(loaded.experiment, console) as interrupt:
        report = run_trials(loaded, store, [trial], 1, console, interrupt, yes)
    for error in report.errors.values():
        raise error
    result = next(iter(report.results.values()), None)
    if result is None or result.outcome is Outcome.INTERRUPTED:
        raise KeyboardInterrupt
    if result.outcome is Outcome.ABORTED:
        raise TetractlError(f"the robots were stopped: {result.reason}", f"log in {folder}")
    return log_path(folder, trial)


@contextmanager
def stoppable(
    experiment: "Experiment", console: "Console", unattended: bool = False
) -> "Iterator[Interrupt]":
    """Compile the controller, then yield an `Interrupt` that counts each signal during the `with`
    block as a request to stop.

    In the lab, unless `unattended`, SIGHUP is sent once no process reads the output.
    """
    from tetractl.cli.streams import first_signal_callback, hung_up_unread
    from tetractl.control.build import warm_up
    from tetractl.run.interrupt import Interrupt, leave_on_signals

    experiment.plant.require_devices()  # before compiling, which may take a minute
    warm_up(experiment, partial(announce_compiling, console.quiet))
    interrupt = Interrupt(first_signal_callback(STOPPING))
    leave_on_signals(Exit.INTERRUPTED)  # for signals that arrive after the block
    in_lab = experiment.plant.real_time
    with hung_up_unread(in_lab, unattended), interrupt.watch(robots=in_lab):
        yield interrupt


def run_trials(
    loaded: "LoadedSpec",
    store: "LogStore",
    trials: list[int],
    jobs: int,
    console: "Console",
    interrupt: "Interrupt",
    yes: bool,
    served: "Sequence[Observer]" = (),
    unattended: bool = False,
) -> "Report":
    """Run trials with their displays and the `served` observers; in the lab, the operator can stop
    the robots by a key.

    The first trial that fails ends the run.
    """
    from tetractl.run.batch import run_batch
    from tetractl.run.executors import Here, on_this_machine
    from tetractl.run.task import batch_tasks

    tasks = batch_tasks(loaded, trials)
    live = console.is_terminal and not console.is_dumb_terminal and jobs == 1 and not console.quiet
    if loaded.experiment.plant.real_time:
        unit = loaded.experiment.units.length
        return run_in_lab(tasks, store, unit, console, interrupt, live, yes, served, unattended)
    if live:
        from tetractl.view.terminal.live_screen import LiveView

        with LiveView(console) as view:
            return run_batch(tasks, store, Here(interrupt, [view, *served]), view, fail_fast=True)
    from tetractl.view.terminal.progress import BatchProgress

    executor = Here(interrupt, served) if served else on_this_machine(jobs, len(tasks), interrupt)
    with BatchProgress(console, len(tasks), loaded.experiment.units.length) as progress:
        return run_batch(tasks, store, executor, progress, fail_fast=True)


def _describe(loaded: "LoadedSpec", folder: Path, trials: list[int]) -> None:
    """Print what a run would do: the resolved spec, then the rest in YAML comments, so that the
    whole text is a valid spec.
    """
    from tetractl.experiment.load import resolved_yaml
    from tetractl.run.task import log_path
    from tetractl.run.trial_limits import limits

    print(f"# {loaded.name} as it would be run; nothing is run or written")
    print("\n".join(map(printable, resolved_yaml(loaded.experiment).split("\n"))), end="")
    print("# Limits")
    for name, value in limits(loaded.experiment).items():
        print(f"#   {name}: {value}")
    print(f"# Trials to run: {len(trials)} of {loaded.experiment.trials.count}")
    if trials:
        ends = [str(log_path(folder, trial)) for trial in dict.fromkeys((trials[0], trials[-1]))]
        print(f"# Logs to write: {' ... '.join(ends)}")


def _conclude(report: "Report", trials: list[int], folder: Path, stopped: bool, json: bool) -> int:
    """Print the statistics of the whole folder, then how the run ended; return the exit code.

    Raises the error of a trial that failed without an outcome.
    """
    from tetractl.cli.streams import first_signal_callback
    from tetractl.run.task import log_path

    error = next(iter(report.errors.values()), None)
    if error and not report.results:
        raise error
    lacking, unprinted = len(trials) - len(report.results), None
    try:
        if report.results or not lacking:
            _print_statistics(folder, json)
    except KeyboardInterrupt:
        first_signal_callback(b"")()
        print("the statistics were left out", file=sys.stderr)
    except (BrokenPipeError, SystemExit):  # rich raises SystemExit on a closed pipe
        pass
    except OSError as failed:
        unprinted = failed
    except TetractlError:
        if not report.aborted:  # an aborted trial may leave no log, or one without poses
            raise
    for (_, trial), result in report.aborted.items():
        print(f"error: trial {trial + 1}: {result.reason}", file=sys.stderr)
    left = f"; {lacking} trials were not run" if lacking else ""
    print(f"logs in {folder}{left}", file=sys.stderr)
    if error:
        raise error
    if report.aborted:
        return Exit.FAILED
    if report.interrupted or (stopped and lacking):
        again = f"the same command and --out {folder} --resume"
        print(f"interrupted; continue with {again}", file=sys.stderr)
        return Exit.INTERRUPTED
    first = min((trial for _, trial in report.results), default=0)
    print(f"look at one with: tetractl replay {log_path(folder, first)}", file=sys.stderr)
    if unprinted:
        raise unprinted
    return Exit.DONE


def _print_statistics(folder: Path, json: bool) -> None:
    from tetractl.cli.stats import show
    from tetractl.results.contrast import contrast
    from tetractl.results.describe import describe
    from tetractl.results.open_batch import open_batch
    from tetractl.run.interrupt import interrupted_once

    with interrupted_once():
        show(contrast([describe(open_batch([folder]))]), "json" if json else "table")
