"""Runs, displays and stops the trials of `run` and `rerun`, the commands that run an experiment.

`run_command` does all of this. It checks the options. Then, in one `with` block, it serves the
trials to viewers, locks the folder of logs, listens to signals and runs the trials. At the end, it
prints the statistics and how the run ended.
"""

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
from tetractl.cli.stats import show
from tetractl.cli.unread import create_signal_notice, discard_unread_output, hang_up_without_reader
from tetractl.core.clock import MonotonicClock
from tetractl.core.errors import Exit, TetractlError, UsageError, printable
from tetractl.run.interrupt import Interrupt, interrupted_once, leave_on_signals
from tetractl.tools.table.terminal_table import open_console

if TYPE_CHECKING:
    from rich.console import Console

    from tetractl.core.protocols import Observer
    from tetractl.run.batch import Report, RunObserver
    from tetractl.run.executors import Executor
    from tetractl.run.store import Store
    from tetractl.spec.experiment import Experiment
    from tetractl.spec.loaded_spec import LoadedSpec
    from tetractl.spec.yaml.settings import FieldValue

STOPPING_NOTICE = b"\nstopping after this step; a second Ctrl-C stops at once\n"
"""Printed by the handler of the first signal."""
DEFAULT_PORT = 8765
"""TCP port at which Foxglove and Lichtblick look for a WebSocket by default."""


def new_log_folder(name: str) -> Path:
    """Return the folder in which an experiment that begins now is logged by default."""
    return Path("logs") / f"{name}-{datetime.now(UTC):%Y%m%dT%H%M%SZ}"


def load_to_run(
    spec: Path,
    sets: Sequence[str],
    plant: str | None,
    values: "Sequence[FieldValue]" = (),
    strict: bool = False,
) -> "LoadedSpec":
    """Load a spec for a run, with the values of options, and for the plant that will be run.

    Its warnings are printed.

    Args:
        spec: The spec.
        sets: Settings such as "trials.count=5".
        plant: The kind of plant. None for the spec's own plant.
        values: Values of options that each set one field. The value is None if an option is not
            given.
        strict: Whether a warning is an error.

    Raises:
        UsageError: If there are warnings, and `strict` is True.
    """
    from tetractl.spec.load import load_document
    from tetractl.spec.plants import adapt_settings, select_plant
    from tetractl.spec.yaml.document import read_document

    document = read_document(spec)
    options = [value for value in values if value.value is not None]
    loaded = load_document(document, [*adapt_settings(document, sets, plant), *options])
    ui.print_warnings(loaded, strict)
    return select_plant(loaded, plant)


@dataclass(frozen=True, slots=True)
class RunOptions:
    """How trials are run: the options of `run`, with their defaults.

    Attributes:
        out: Folder for the logs. None for a new folder in ./logs.
        jobs: Number of trials that run at the same time.
        resume: Whether to run only the trials that are missing in `out`.
        keep_going: Whether the batch goes on after an aborted trial. None for the plant's default.
        dry_run: Whether the spec is only checked, and no trial is run.
        quiet: Whether only the result is printed.
        yes: Whether robots may move without asking the user first.
        port: Port at which viewers can watch the trials. If it is None, they cannot.
        json: Whether the result is printed as JSON.
        unattended: Whether a closed terminal does not stop the robots.
        rate: Speed of simulated trials as a multiple of real time. None for as fast as possible.
    """

    out: Path | None = None
    jobs: int = 1
    resume: bool = False
    keep_going: bool | None = None
    dry_run: bool = False
    quiet: bool = False
    yes: bool = False
    port: int | None = None
    json: bool = False
    unattended: bool = False
    rate: float | None = None


def choose_port(serve: bool, port: int | None) -> int | None:
    """Return the port at which viewers can watch the trials. None without --serve.

    Raises:
        UsageError: If a port is given without --serve.
    """
    if not serve:
        if port is not None:
            raise UsageError("--port needs --serve")
        return None
    return DEFAULT_PORT if port is None else port


def run_command(
    loaded: "LoadedSpec", options: RunOptions, only_trial: int | None = None
) -> tuple[int, Path]:
    """Run the trials of a spec, and print the statistics.

    With `dry_run`, only the spec is printed. With `resume`, trials that already have a log are not
    run again. Otherwise, a folder with logs is refused.

    Args:
        loaded: The spec.
        options: Options of the command.
        only_trial: Index of the only trial to run. None to run all.

    Returns:
        The exit code and the logs' folder.
    """
    from tetractl.run.store import Store

    experiment = loaded.experiment
    in_lab = experiment.plant.real_time
    if in_lab and options.jobs > 1:
        raise UsageError("--jobs works only in virtual time: the lab runs one trial at a time")
    if in_lab and options.rate is not None:
        raise UsageError(
            "--rate works only in virtual time: robots in the lab move at their own speed"
        )
    if options.unattended and not (in_lab and options.yes):
        raise UsageError("--unattended is only for robots in a lab", "add --plant lab --yes")

    folder = options.out or new_log_folder(experiment.name)
    store = Store.of_batch(folder, experiment)
    if options.dry_run:
        store.read(options.resume)
        _print_plan(loaded, folder, _list_planned(store, only_trial))
        return Exit.DONE, folder
    if in_lab:
        ui.require_yes_or_terminal(options.yes)
    with (
        _serve_trials(experiment.name, options.port) as viewers,
        store.opened(options.resume),
        stop_on_signals(loaded, options) as interrupt,
    ):
        planned = _list_planned(store, only_trial)
        report = _run_trials(loaded, store, planned, options, interrupt, viewers)
        code = _conclude(report, planned, interrupt, in_lab, store, options.json)
        return code, folder


def _list_planned(store: "Store", only_trial: int | None) -> list[int]:
    """Return the numbers of the trials that are to be run."""
    return store.unfinished if only_trial is None else [only_trial]


def _print_plan(loaded: "LoadedSpec", folder: Path, planned: list[int]) -> None:
    """Print what a run would do: the complete spec, then further facts as YAML comments.

    The whole text is therefore a valid spec.
    """
    from tetractl.run.logged_trial import log_path
    from tetractl.spec.loaded_spec import resolved_yaml

    print(f"# The complete spec of {loaded.name}; nothing is run or written")
    for line in resolved_yaml(loaded.experiment).removesuffix("\n").split("\n"):
        print(printable(line))
    print("# Limits")
    for name, value in _describe_limits(loaded.experiment).items():
        print(f"#   {name}: {value}")
    print(f"# Trials to run: {len(planned)} of {loaded.experiment.trials.count}")
    if len(planned) == 1:
        print(f"# Logs to write: {log_path(folder, planned[0])}")
    elif planned:
        first_log = log_path(folder, planned[0])
        last_log = log_path(folder, planned[-1])
        print(f"# Logs to write: {first_log} ... {last_log}")


def _describe_limits(experiment: "Experiment") -> dict[str, str]:
    """Return the limits of a trial as text, by name."""
    control = experiment.controller
    unit = experiment.units.length
    duration_max_s = control.time_limit
    speed_max = max(robot.speed for robot in experiment.robots)
    common_limits = {
        "control period": f"{control.period:g} s",
        "duration of a trial": f"at most {duration_max_s:g} s after the first command",
        "path of a robot": f"at most {speed_max * duration_max_s:g} {unit}",
    }
    return common_limits | control.bounds() | experiment.plant.bounds()


# ---- While trials run ----


@contextmanager
def _serve_trials(name: str, port: int | None) -> "Iterator[Sequence[Observer]]":
    """Yield observers that stream the trials of a `with` block to log viewers.

    There are none if `port` is None.
    """
    if port is None:
        yield ()
        return
    from tetractl.serve.live import ServedRun, Viewers
    from tetractl.serve.server import LoopbackServer

    viewers = Viewers(name)
    with LoopbackServer(viewers, port) as server:
        ui.print_messages(f"served at {server.url}")
        yield [ServedRun(viewers, MonotonicClock())]


@contextmanager
def stop_on_signals(
    loaded: "LoadedSpec", options: RunOptions, by_keys: bool = False
) -> "Iterator[Interrupt]":
    """Compile the controller, then let signals request the end of the run in the `with` block.

    Each signal counts as a request to stop. In the lab, unless `unattended`, SIGHUP is sent once no
    process reads the output.

    Args:
        loaded: The spec.
        options: Options of the command.
        by_keys: Whether keys are read from the terminal. Then Ctrl-Z in the lab also counts.
    """
    from tetractl.control.methods.build import warm_up

    lab = loaded.experiment.plant.real_time
    loaded.experiment.plant.require_devices()  # before compiling, which may take a minute
    warm_up(loaded.experiment, partial(ui.announce_compiling, options.quiet))
    gc.freeze()  # exempts the compiler's objects from garbage collection
    interrupt = Interrupt(create_signal_notice(STOPPING_NOTICE))
    leave_on_signals(Exit.INTERRUPTED)  # for signals that arrive after the block
    with (
        hang_up_without_reader(lab, options.unattended),
        interrupt.watch(robots_move=lab or by_keys),
    ):
        yield interrupt


def _run_trials(
    loaded: "LoadedSpec",
    store: "Store",
    planned: list[int],
    options: RunOptions,
    interrupt: Interrupt,
    viewers: "Sequence[Observer]",
) -> "Report":
    """Run trials, display them, and report them to `viewers`, until one ends the batch.

    `_prepare_in_lab` shows the trials of the lab, `_prepare_on_screen` the trials that run one
    after another on a terminal, and `prepare_in_lines` all others.
    """
    from tetractl.run.batch import OnFailure, run_batch
    from tetractl.run.hand import WallPace
    from tetractl.run.task import batch_tasks
    from tetractl.view.terminal.screen import can_show_screens

    if options.rate is not None:
        viewers = [*viewers, WallPace(MonotonicClock(), options.rate)]
    tasks = batch_tasks(loaded, planned)
    console = open_console(stderr=True, quiet=options.quiet)
    screen = can_show_screens(console) and not options.quiet
    if loaded.experiment.plant.real_time:
        display = _prepare_in_lab(loaded.experiment, console, screen, options, interrupt, viewers)
    elif screen and options.jobs == 1:
        display = _prepare_on_screen(console, interrupt, viewers)
    else:
        unit = loaded.experiment.units.length
        display = prepare_in_lines(console, unit, len(tasks), options.jobs, interrupt, viewers)
    on_failure = OnFailure.of_batch(loaded.experiment.plant, options.keep_going)
    with display as (executor, observer):
        return run_batch(tasks, store, executor, observer, on_failure)


@contextmanager
def _prepare_in_lab(
    experiment: "Experiment",
    console: "Console",
    has_screen: bool,
    options: RunOptions,
    interrupt: Interrupt,
    viewers: "Sequence[Observer]",
) -> "Iterator[tuple[Executor, RunObserver]]":
    """Prepare trials in the lab: yield the object that runs them and the one that shows them.

    The terminal's space bar and Esc stop the robots at any time, and a person there starts each
    trial, unless `yes`. If `unattended`, a closed terminal does not stop the robots.
    """
    from tetractl.core.protocols import LabSupervision
    from tetractl.run.executors import InProcessExecutor
    from tetractl.view.terminal.keys import NO_KEY, STOP_HINT, StopKey
    from tetractl.view.terminal.live_screen import LabView, TerminalPrompt

    stop_console = open_console(stderr=True)  # prints with --quiet, too
    emergency = threading.Event()
    entered = threading.Event()
    with StopKey(emergency.set, entered.set, options.unattended) as key:
        hint = STOP_HINT if key.listening else NO_KEY
        stop_console.print(hint, style="bold", highlight=False)
        asks_person = key.listening and not options.yes
        prompt = TerminalPrompt(stop_console, entered) if asks_person else None
        supervision = LabSupervision(emergency, prompt, lambda: interrupt.requested)
        watch = LabView(
            stop_console, console, experiment.units.length, has_screen and key.listening
        )
        yield InProcessExecutor(interrupt, [watch, *viewers], supervision), watch


@contextmanager
def _prepare_on_screen(
    console: "Console", interrupt: Interrupt, viewers: "Sequence[Observer]"
) -> "Iterator[tuple[Executor, RunObserver]]":
    """Prepare trials in this process: yield the object that runs them, and a live view of each."""
    from tetractl.run.executors import InProcessExecutor
    from tetractl.view.terminal.live_screen import LiveView

    with LiveView(console) as view:
        yield InProcessExecutor(interrupt, [view, *viewers]), view


@contextmanager
def prepare_in_lines(
    console: "Console",
    unit: str,
    count: int,
    jobs: int,
    interrupt: Interrupt,
    viewers: "Sequence[Observer]",
) -> "Iterator[tuple[Executor, RunObserver]]":
    """Prepare trials whose progress is printed as one line each.

    Args:
        console: The console.
        unit: Length unit of the experiment.
        count: Number of trials.
        jobs: Number of processes. Trials with viewers run in this process.
        interrupt: Requests to end.
        viewers: Observers that send the trials to viewers.

    Yields:
        The object that runs the trials, and the object that prints the lines.
    """
    from tetractl.run.executors import InProcessExecutor, local_executor
    from tetractl.view.terminal.progress import BatchProgress

    executor = local_executor(jobs, count, interrupt)
    if viewers:
        executor = InProcessExecutor(interrupt, viewers)
    with BatchProgress(console, count, unit) as progress:
        yield executor, progress


# ---- The end of a run ----


def _conclude(
    report: "Report",
    planned: list[int],
    interrupt: Interrupt,
    in_lab: bool,
    store: "Store",
    as_json: bool,
) -> int:
    """Print the statistics of the whole folder and how the run ended, and return the exit code.

    The error of a trial without a result is raised. If no trial has a result, nothing is printed
    before that.
    """
    from tetractl.run.logged_trial import log_path

    folder = store.folder
    not_run = len(planned) - len(report.results)
    interrupted = report.interrupted or (interrupt.requested and not_run > 0)
    error = next(iter(report.errors.values()), None)
    complete = error is None and not report.aborted and not interrupted
    if error is not None and not report.results:
        raise error
    statistics_error = None
    if report.results or not not_run:
        statistics_error = _print_statistics(folder, as_json, logs_may_lack=bool(report.aborted))
    if statistics_error is not None and not complete:  # of a complete run, it is the error
        ui.print_messages(
            "error: the statistics were not written: "
            f"{statistics_error.strerror or statistics_error}"
        )
    unrun_note = f"; {not_run} trials were not run" if not_run else ""
    ui.print_messages(
        f"logs are in {folder}{unrun_note}; this command prints all figures: tetractl stats "
        f"{quote(str(folder))} --full"
    )
    for (_, trial), result in report.aborted.items():  # last: it may name robots that still move
        ui.print_messages(f"error: trial {trial + 1}: {result.reason}")

    if error is not None:
        raise error
    last_aborted = bool(report.results) and next(reversed(report.results)) in report.aborted
    if interrupted and not last_aborted:
        resume_hint = (
            f"to continue, run the same command again with --out {quote(str(folder))} --resume"
        )
        if in_lab and interrupt.terminated:
            ui.print_messages(
                "interrupted by a signal. If the signal came from `tetractl lab stop`, the "
                f"robots stay stopped until you switch each off and on; then, {resume_hint}"
            )
        else:
            ui.print_messages(f"interrupted; {resume_hint}")
        return Exit.INTERRUPTED
    aborts = report.aborted.values()
    if not_run and aborts and all(result.verdict.can_restart for result in aborts):
        ui.print_messages("hint: with --keep-going, a batch goes on after an abort like this one")
    if report.aborted or store.aborted:
        return Exit.FAILED
    first_trial = min((trial for _, trial in report.results), default=0)
    first_log = log_path(folder, first_trial)
    ui.print_messages(f"look at one of them with: tetractl replay {quote(str(first_log))}")
    if statistics_error is not None:
        raise statistics_error
    return Exit.DONE


def _print_statistics(folder: Path, as_json: bool, logs_may_lack: bool) -> OSError | None:
    """Print the statistics of a folder's logs on stdout. Return why they could not be written.

    They are left out at a signal, and where the reader of stdout has ended. With `logs_may_lack`,
    logs that cannot be described are no error: an aborted trial may leave none, or one without
    poses.
    """
    from tetractl.statistics.describe import contrast, describe
    from tetractl.statistics.open_batch import open_batch

    try:
        with interrupted_once():
            statistics = describe(open_batch([folder]))
            show(contrast([statistics]), "json" if as_json else "table")
    except KeyboardInterrupt:
        discard_unread_output()
        ui.print_messages("the statistics were not computed")
    except (BrokenPipeError, SystemExit):  # rich raises SystemExit on a closed pipe
        pass
    except OSError as error:
        return error
    except TetractlError:
        if not logs_may_lack:
            raise
    return None
