"""`tetractl run`: run the trials of an experiment."""

import sys
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tetractl.cli.caution import Strict, Yes, need_consent, refuse, warn
from tetractl.cli.options import Sets
from tetractl.cli.serving import Port, Serve, served_run, wanted_port
from tetractl.core.errors import Exit, UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from tetractl.core.protocols import Observer
    from tetractl.experiment.load import LoadedSpec
    from tetractl.run.batch import Report
    from tetractl.run.interrupt import Interrupt

STOPPING = b"\nstopping after this step; a second Ctrl-C stops at once\n"


class PlantChoice(StrEnum):
    """The plant of a run."""

    SIM = "sim"
    LAB = "lab"


def run(
    spec: Annotated[
        Path | None, typer.Argument(metavar="SPEC", help="The experiment, a YAML file.")
    ] = None,
    trials: Annotated[
        int | None, typer.Option(metavar="N", help="Number of trials.  \\[spec: trials.count]")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(metavar="S", help="Root seed.  \\[spec: trials.seed]")
    ] = None,
    sets: Sets = None,
    plant: Annotated[
        PlantChoice | None,
        typer.Option(
            help="Simulate, or drive the robots of the spec's lab.  \\[spec: plant.type; sim with "
            "--from]"
        ),
    ] = None,
    yes: Yes = False,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            metavar="DIR",
            help="Folder for the logs.  \\[logs/<spec name>-<UTC time>]",
        ),
    ] = None,
    jobs: Annotated[
        int, typer.Option(min=1, metavar="N", help="Trials at a time, each in its process.")
    ] = 1,
    resume: Annotated[
        bool, typer.Option("--resume", help="Run only the trials that DIR still lacks.")
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the spec, its limits and what would be run.")
    ] = False,
    strict: Strict = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="No live view, no progress.")
    ] = False,
    serve: Serve = False,
    port: Port = None,
    record_wire: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Lab only: keep every datagram and serial byte of each trial here."
        ),
    ] = None,
    log: Annotated[
        Path | None,
        typer.Option(
            "--from",
            metavar="LOG",
            help="In place of SPEC: simulate the trial of a log again, and compare. Only with "
            "--plant lab do robots move.",
        ),
    ] = None,
    json: Annotated[
        bool, typer.Option("--json", help="Print the statistics as `stats --format json` does.")
    ] = False,
) -> int:
    """Run the trials of an experiment, log each to DIR/trial-000.mcap ..., print the statistics.

    In the lab a person at the terminal is shown where robots must stand and starts them by Enter;
    without a terminal it takes --yes.

    With --serve a simulated trial takes as long as a real one.

    Ctrl-C finishes the step, stops the robots and closes the log; a second one does so at once.

    Example: tetractl run experiments/three_m3pi.yaml --trials 5 --set plant.dead_time=0.1
    """
    from rich.console import Console

    from tetractl.cli.spec import load
    from tetractl.cli.streams import hurrier
    from tetractl.control.build import warm_up
    from tetractl.experiment.plants import on_plant
    from tetractl.log.read.find import find_log
    from tetractl.replay.rerun import compare, recorded
    from tetractl.run.batch import log_path
    from tetractl.run.folder import batch_folder, default_folder, trials_to_run
    from tetractl.run.interrupt import Interrupt, leave_on_signals
    from tetractl.run.limits import check

    if resume and out is None:
        raise UsageError("--resume needs --out", "name the folder of the batch to go on with")
    if (spec is None) == (log is None):
        raise UsageError("name either a SPEC or, with --from, a LOG")
    settings = list(sets or [])
    settings += [] if trials is None else [f"trials.count={trials}"]
    settings += [] if seed is None else [f"trials.seed={seed}"]
    if log is not None and (settings or resume):
        raise UsageError("--from repeats a trial as it was: nothing of it can be set")
    number = None
    if spec is not None:
        loaded = load(spec, settings)
        cautions = warn(loaded, settings)
        if strict:
            refuse(cautions)
        loaded = on_plant(loaded, plant.value if plant else None)
    else:
        assert log is not None
        log = find_log(log)
        loaded, number = recorded(log, plant.value if plant else "sim")
    _check_lab_options(loaded, jobs, record_wire)
    served_port = wanted_port(serve, port)
    if serve and jobs > 1:
        raise UsageError("--serve shows one trial at a time", "leave out --jobs")
    check(loaded.experiment)
    folder = out or default_folder(loaded.experiment.name, datetime.now(UTC))
    if dry_run:
        todo = trials_to_run(loaded.experiment, folder, resume)
        _describe(loaded, folder, todo if number is None else [number])
        return Exit.DONE
    if not loaded.experiment.plant.simulated:
        need_consent(yes)
    console = Console(stderr=True, quiet=quiet)
    name = loaded.experiment.name
    with (
        served_run(name, served_port) as served,
        batch_folder(loaded.experiment, folder, resume) as todo,
    ):
        todo = todo if number is None else [number]
        warm_up(loaded.experiment, lambda text: console.print(text, highlight=False))
        interrupt = Interrupt(hurrier(STOPPING))
        leave_on_signals(Exit.INTERRUPTED)  # again, once all is said
        with interrupt.watch(robots=not loaded.experiment.plant.simulated):
            report = run_todo(
                loaded, folder, todo, jobs, console, interrupt, record_wire, yes, served
            )
            code = _conclude(report, folder, json)
    if log is not None and number in report.results and code == Exit.DONE:
        return compare(log, log_path(folder, number))
    return code


def _describe(loaded: "LoadedSpec", folder: Path, todo: list[int]) -> None:
    """Print what a run would do; as YAML throughout, so that it can be kept as a spec."""
    from tetractl.experiment.load import resolved_yaml
    from tetractl.run.batch import log_path
    from tetractl.run.limits import limits

    print(f"# {loaded.name} as it would be run; nothing is run or written")
    print(resolved_yaml(loaded.experiment), end="")
    print("# Limits")
    for name, value in limits(loaded.experiment).items():
        print(f"#   {name}: {value}")
    print(f"# Trials to run: {len(todo)} of {loaded.experiment.trials.count}")
    if todo:
        ends = [str(log_path(folder, trial)) for trial in dict.fromkeys((todo[0], todo[-1]))]
        print(f"# Logs to write: {' ... '.join(ends)}")


def _check_lab_options(loaded: "LoadedSpec", jobs: int, record_wire: Path | None) -> None:
    in_lab = not loaded.experiment.plant.simulated
    if in_lab and jobs > 1:
        raise UsageError("--jobs: the lab runs one trial at a time")
    if record_wire is not None and not in_lab:
        raise UsageError("--record-wire: a simulation has no wire", "add --plant lab")


def run_todo(
    loaded: "LoadedSpec",
    folder: Path,
    todo: list[int],
    jobs: int,
    console: "Console",
    interrupt: "Interrupt",
    record_wire: Path | None,
    yes: bool,
    served: "Sequence[Observer]" = (),
) -> "Report":
    """Run trials with what shows them, `served` among it: in the lab with the operator's stop."""
    from tetractl.run.batch import run_batch

    live = console.is_terminal and not console.is_dumb_terminal and jobs == 1 and not console.quiet
    if not loaded.experiment.plant.simulated:
        from tetractl.cli.lab_run import run_in_lab

        return run_in_lab(loaded, folder, todo, console, interrupt, live, record_wire, yes, served)
    if live:
        from tetractl.view.terminal.live import LiveView

        with LiveView(console) as view:
            return run_batch(loaded, folder, todo, jobs, interrupt, view, [view, *served])
    from tetractl.view.terminal.progress import BatchProgress

    with BatchProgress(console, len(todo), loaded.experiment.units.length) as progress:
        return run_batch(loaded, folder, todo, jobs, interrupt, progress, served)


def _conclude(report: "Report", folder: Path, json: bool) -> int:
    """Print the statistics of the whole folder, then how the run ended; return the exit code."""
    from tetractl.cli.streams import hurrier
    from tetractl.run.batch import log_path

    if report.refused and not report.results:
        raise report.refused
    unprinted = None
    if report.results or not report.not_run:
        try:
            _print_statistics(folder, json)
        except KeyboardInterrupt:
            hurrier(b"")()
            print("the statistics were left out", file=sys.stderr)
        except (BrokenPipeError, SystemExit):  # the latter is rich's: nobody reads them
            pass
        except OSError as error:
            unprinted = error
        except UsageError:
            if not report.aborted:  # an aborted trial may leave no log, or one without poses
                raise
    for trial, result in report.aborted.items():
        print(f"error: trial {trial + 1}: {result.reason}", file=sys.stderr)
    left = f"; {len(report.not_run)} trials were not run" if report.not_run else ""
    print(f"logs in {folder}{left}", file=sys.stderr)
    if report.refused:
        raise report.refused
    if report.aborted:
        return Exit.FAILED
    if report.interrupted:
        again = f"the same command and --out {folder} --resume"
        print(f"interrupted; go on with {again}", file=sys.stderr)
        return Exit.INTERRUPTED
    print(
        f"look at one with: tetractl replay {log_path(folder, min(report.results, default=0))}",
        file=sys.stderr,
    )
    if unprinted:
        raise unprinted
    return Exit.DONE


def _print_statistics(folder: Path, json: bool) -> None:
    from tetractl.results.batch import open_batch
    from tetractl.results.contrast import contrast
    from tetractl.results.describe import describe
    from tetractl.results.show import show
    from tetractl.run.interrupt import interrupted_once

    with interrupted_once():
        show(contrast([describe(open_batch([folder]))]), "json" if json else "table")
