"""Runs, displays and stops the trials of `run`, `rerun` and other commands that drive a plant."""

import gc
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

from tetractl.cli import ui
from tetractl.cli.unread import give_up_unread, hung_up_unread, notice_of_signals
from tetractl.core.errors import Exit, TetractlError, UsageError, printable
from tetractl.run.interrupt import Interrupt, interrupted_once, leave_on_signals

if TYPE_CHECKING:
    from tetractl.core.protocols import Observer
    from tetractl.experiment.experiment import Experiment
    from tetractl.experiment.load import LoadedSpec
    from tetractl.run.batch import Report, RunObserver
    from tetractl.run.executors import Executor
    from tetractl.run.store import Store

STOPPING = b"\nstopping after this step; a second Ctrl-C stops at once\n"


PORT = 8765
"""TCP port at which Foxglove and Lichtblick look for a WebSocket by default."""


@dataclass(frozen=True, slots=True)
class RunOptions:
    """How trials are run: the options of `run`. They are served at `port`, unless it is None."""

    out: Path | None = None
    jobs: int = 1
    resume: bool = False
    dry_run: bool = False
    quiet: bool = False
    yes: bool = False
    port: int | None = None
    json: bool = False
    unattended: bool = False


def run_command(
    loaded: "LoadedSpec", options: RunOptions, only: int | None = None
) -> tuple[int, Path]:
    """Run the trials of a spec, or only trial `only`, and print the statistics; with `dry_run`,
    only print the spec. Return the exit code and the logs' folder.
    """
    from tetractl.run.store import Store, default_folder
    from tetractl.run.trial_limits import check

    experiment, lab = loaded.experiment, loaded.experiment.plant.real_time
    if lab and options.jobs > 1:
        raise UsageError("--jobs is for virtual time: the lab runs one trial at a time")
    if options.unattended and not (lab and options.yes):
        raise UsageError("--unattended is only for robots in the lab", "add --plant lab --yes")
    check(experiment)
    folder = options.out or default_folder(experiment.name, datetime.now(UTC))
    store = Store.of_batch(folder, experiment)
    if options.dry_run:
        store.read(options.resume)
        _describe(loaded, folder, store.lacking if only is None else [only])
        return Exit.DONE, folder
    if lab:
        ui.require_confirmation(options.yes)
    with (
        _served(experiment.name, options.port) as served,
        store.opened(options.resume),
        _stoppable(loaded, options) as interrupt,
    ):
        todo = store.lacking if only is None else [only]
        report = _run_trials(loaded, store, todo, options, interrupt, served)
        return _conclude(report, todo, folder, interrupt.requested, options.json), folder


def wanted_port(serve: bool, port: int | None) -> int | None:
    """Return the port to serve at, None without --serve; UsageError for a port without --serve."""
    if port is not None and not serve:
        raise UsageError("--port needs --serve")
    return PORT if serve and port is None else port


@contextmanager
def _served(name: str, port: int | None) -> "Iterator[Sequence[Observer]]":
    """Yield the observers that send the trials of a `with` block to viewers; none if `port` is
    None."""
    if port is None:
        yield ()
        return
    from tetractl.core.clock import MonotonicClock
    from tetractl.serve.live import ServedRun, Viewers
    from tetractl.serve.server import LoopbackServer

    viewers = Viewers(name)
    with LoopbackServer(viewers, port) as server:
        ui.tell(f"served at {server.url}")
        yield [ServedRun(viewers, MonotonicClock())]


@contextmanager
def _stoppable(loaded: "LoadedSpec", options: RunOptions) -> "Iterator[Interrupt]":
    """Compile the controller, then yield an `Interrupt` that counts each signal during the `with`
    block as a request to stop.

    In the lab, unless `unattended`, SIGHUP is sent once no process reads the output.
    """
    from tetractl.control.build import warm_up

    lab = loaded.experiment.plant.real_time
    loaded.experiment.plant.require_devices()  # before compiling, which may take a minute
    warm_up(loaded.experiment, partial(ui.announce_compiling, options.quiet))
    gc.freeze()  # exempts the compiler's objects from garbage collection
    interrupt = Interrupt(notice_of_signals(STOPPING))
    leave_on_signals(Exit.INTERRUPTED)  # for signals that arrive after the block
    with hung_up_unread(lab, options.unattended), interrupt.watch(robots=lab):
        yield interrupt


def _run_trials(
    loaded: "LoadedSpec",
    store: "Store",
    trials: list[int],
    options: RunOptions,
    interrupt: "Interrupt",
    served: "Sequence[Observer]" = (),
) -> "Report":
    """Run trials with their display and the `served` observers, until the first that fails."""
    from tetractl.run.batch import run_batch
    from tetractl.run.task import batch_tasks

    experiment, tasks = loaded.experiment, batch_tasks(loaded, trials)
    with _display(experiment, len(tasks), options, interrupt, served) as (executor, observer):
        return run_batch(tasks, store, executor, observer, fail_fast=True)


@contextmanager
def _display(
    experiment: "Experiment",
    count: int,
    options: RunOptions,
    interrupt: "Interrupt",
    served: "Sequence[Observer]",
) -> "Iterator[tuple[Executor, RunObserver]]":
    """Yield what runs `count` trials and what shows them: a live view, or a line for each.

    In the lab the terminal's space bar and Esc stop the robots at any time, and a person there
    starts each trial, unless `yes`. If `unattended`, a closed terminal does not stop them.
    """
    from rich.console import Console

    from tetractl.core.protocols import LabSupervision
    from tetractl.run.executors import Here, on_this_machine
    from tetractl.view.terminal.keys import SAYS, StopKey
    from tetractl.view.terminal.live_screen import LabWatch, LiveView, TerminalPrompt
    from tetractl.view.terminal.progress import BatchProgress

    unit, console = experiment.units.length, Console(stderr=True, quiet=options.quiet)
    live = console.is_terminal and not console.is_dumb_terminal and not options.quiet
    if experiment.plant.real_time:
        always = Console(stderr=True)  # messages on safety are always printed
        emergency, entered = threading.Event(), threading.Event()
        with StopKey(emergency.set, entered.set, options.unattended) as key:
            says = SAYS if key.listening else "no terminal: there is no key to stop the robots"
            always.print(says, style="bold", highlight=False)
            asks = key.listening and not options.yes
            prompt = TerminalPrompt(always, entered) if asks else None
            supervision = LabSupervision(emergency, prompt, lambda: interrupt.requested)
            watch = LabWatch(always, console, unit, live and key.listening)
            yield Here(interrupt, [watch, *served], supervision), watch
    elif live and options.jobs == 1:
        with LiveView(console) as view:
            yield Here(interrupt, [view, *served]), view
    else:
        here = on_this_machine(options.jobs, count, interrupt)
        with BatchProgress(console, count, unit) as progress:
            yield Here(interrupt, served) if served else here, progress


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
    from tetractl.cli.stats import show
    from tetractl.results.contrast import contrast
    from tetractl.results.describe import describe
    from tetractl.results.open_batch import open_batch
    from tetractl.run.task import log_path

    error = next(iter(report.errors.values()), None)
    if error and not report.results:
        raise error
    lacking, unprinted = len(trials) - len(report.results), None
    try:
        if report.results or not lacking:
            with interrupted_once():
                show(contrast([describe(open_batch([folder]))]), "json" if json else "table")
    except KeyboardInterrupt:
        give_up_unread()
        ui.tell("the statistics were left out")
    except (BrokenPipeError, SystemExit):  # rich raises SystemExit on a closed pipe
        pass
    except OSError as failed:
        unprinted = failed
    except TetractlError:
        if not report.aborted:  # an aborted trial may leave no log, or one without poses
            raise
    for (_, trial), result in report.aborted.items():
        ui.tell(f"error: trial {trial + 1}: {result.reason}")
    left = f"; {lacking} trials were not run" if lacking else ""
    ui.tell(f"logs in {folder}{left}; every figure: tetractl stats {quote(str(folder))} --full")
    if error:
        raise error
    if report.aborted:
        return Exit.FAILED
    if report.interrupted or (stopped and lacking):
        ui.tell(f"interrupted; continue with the same command and --out {folder} --resume")
        return Exit.INTERRUPTED
    first = min((trial for _, trial in report.results), default=0)
    ui.tell(f"look at one with: tetractl replay {quote(str(log_path(folder, first)))}")
    if unprinted:
        raise unprinted
    return Exit.DONE
