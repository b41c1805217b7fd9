"""`tetractl study`: many arms of trials in the same worlds, here, in shares or on a cluster."""

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tetractl.core.errors import Exit, TetractlError, UsageError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from contextlib import AbstractContextManager

    from rich.console import Console

    from tetractl.run.interrupt import Interrupt
    from tetractl.study.load import LoadedStudy
    from tetractl.study.options import Logs, Shard
    from tetractl.study.run import Executor, Report
    from tetractl.study.store import Store
    from tetractl.study.work import Task

STOPPING = b"\nstopping after the steps that run; a second Ctrl-C stops at once\n"


def study(
    file: Annotated[Path, typer.Argument(metavar="STUDY", help="The study, a YAML file.")],
    folders: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[DIR]...", help="Only with --merge: folders of its shares."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o", "--out", metavar="DIR", help="Folder of the study.  \\[logs/<study name>]"
        ),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(
            min=1, metavar="N", help="Trials at a time, each in its process.  \\[processors]"
        ),
    ] = None,
    logs: Annotated[
        str,
        typer.Option(metavar="all|failed|sample:N|none", help="Which trials leave their logs."),
    ] = "all",
    fail_fast: Annotated[
        bool, typer.Option("--fail-fast", help="Stop at the first trial that fails.")
    ] = False,
    again: Annotated[
        bool, typer.Option("--again", help="Run the trials of older code again.")
    ] = False,
    shard: Annotated[
        str | None,
        typer.Option(metavar="I/N", help="Run only the I-th of N shares, in a folder of its own."),
    ] = None,
    merge: Annotated[
        bool, typer.Option("--merge", help="Run nothing: gather the trials of the folders DIR.")
    ] = False,
    cluster: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Run on the Dask cluster of this scheduler."),
    ] = None,
    trial: Annotated[
        str | None,
        typer.Option(
            metavar="ARM/N", help="Run one trial again, to its log, and check it against its row."
        ),
    ] = None,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="No progress; failures are told.")
    ] = False,
) -> int:
    """Run every arm of a study in the same worlds; write one table, and a figure a swept field.

    The same command goes on with what an interrupted study lacks. A trial that fails does not stop
    the others; the exit code then is 1.

    Example: tetractl study experiments/studies/dead_time.yaml --logs none
    """
    from rich.console import Console

    from tetractl.study.load import load_study
    from tetractl.study.options import Logs, Shard
    from tetractl.study.store import Store
    from tetractl.study.store import merge as merged

    if sum(option is not None for option in (cluster, jobs)) > 1:
        raise UsageError("--jobs is for this machine, --cluster for others: give one of them")
    if merge != bool(folders):
        raise UsageError("--merge and the folders to gather go together")
    if sum([shard is not None, merge, trial is not None]) > 1:
        raise UsageError("--shard, --merge and --trial do different things: give one of them")
    rule, share = Logs.parse(logs), Shard.parse(shard) if shard else Shard()
    loaded = load_study(file)
    ending = f"-shard-{share.index}-of-{share.of}" if shard else ""
    folder = out or Path("logs") / f"{loaded.study.name}{ending}"
    store, console = Store(folder, loaded.arms), Console(stderr=True)
    with store.opened(loaded.arms):
        if trial is not None:
            from tetractl.study.repeat import repeat

            print(repeat(loaded, store, trial))
            return Exit.DONE
        if merge:
            added = merged(store, loaded.arms, folders or [])
            print(f"{added} trials added to {folder}", file=sys.stderr)
            return _conclude(loaded, store, share, None)
        report, stopped = _run(
            loaded, store, rule, share, again, fail_fast, cluster, jobs, console, quiet
        )
        return _conclude(loaded, store, share, report, stopped)


def _run(
    loaded: "LoadedStudy",
    store: "Store",
    rule: "Logs",
    share: "Shard",
    again: bool,
    fail_fast: bool,
    cluster: str | None,
    jobs: int | None,
    console: "Console",
    quiet: bool,
) -> "tuple[Report, bool]":
    """Run what is to be run; return what became of it, and whether somebody stopped it."""
    from contextlib import ExitStack, suppress

    from tetractl.cli.streams import hurrier
    from tetractl.control.build import warm_up
    from tetractl.run.interrupt import Interrupt, leave_on_signals
    from tetractl.study.run import planned, run_study

    plan = planned(loaded, store, rule, share, again)
    if plan.older:
        print(
            f"notice: {sum(plan.older.values())} trials are of older code and are kept:"
            f" {_listed(plan.older)}; run them again with --again",
            file=sys.stderr,
        )
    from tetractl.study.progress import StudyProgress

    interrupt = Interrupt(hurrier(STOPPING))
    with ExitStack() as stack:
        if cluster is None and plan.tasks:
            named = {arm.controller: arm for arm in loaded.arms}
            for arm in named.values():
                with suppress(TetractlError):  # its trials say so themselves
                    warm_up(arm.spec.experiment, lambda text: console.print(text, highlight=False))
        leave_on_signals(Exit.INTERRUPTED)
        executor = stack.enter_context(
            _executor(loaded, store, cluster, jobs, len(plan.tasks), interrupt)
        )
        if not quiet:
            count = loaded.study.trials.count
            print(
                f"{loaded.study.name}: {len(loaded.arms)} arms of {count} trials,"
                f" {len(plan.tasks)} of {len(loaded.arms) * count} to run,"
                f" {executor.workers} at a time",
                file=sys.stderr,
            )
        stack.enter_context(interrupt.watch())
        shown = StudyProgress(console, len(plan.tasks), quiet)
        observer = stack.enter_context(shown)
        report = run_study(loaded.arms, store, executor, plan.tasks, fail_fast, observer)
    return report, interrupt.requested


def _executor(
    loaded: "LoadedStudy",
    store: "Store",
    cluster: str | None,
    jobs: int | None,
    tasks: int,
    interrupt: "Interrupt",
) -> "AbstractContextManager[Executor]":
    """Return what runs the trials: a Dask cluster, or this machine's processors."""
    from contextlib import nullcontext

    def place(task: "Task") -> Path:
        return store.clear(loaded.arms[task.arm], task.trial)

    if cluster is not None:
        from tetractl.study.cluster import Cluster

        return Cluster(cluster, interrupt, place)
    from tetractl.study.local import Local

    available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return nullcontext(Local(max(min(jobs or available or 1, tasks), 1), interrupt, place))


def _conclude(
    loaded: "LoadedStudy",
    store: "Store",
    share: "Shard",
    report: "Report | None",
    stopped: bool = False,
) -> int:
    """Write tables and figures, print the errors, say what is lacking; return the exit code."""
    from tetractl.core.table.show import print_tables
    from tetractl.study.figure import write_figures
    from tetractl.study.table import arms_table, counted_rows, write_tables

    rows = [row for _, row in counted_rows(loaded, store)]
    if rows:
        paths = [*write_tables(loaded, store), *write_figures(loaded, store)]
        print_tables([arms_table(loaded, store)])
        print(*paths, sep="\n")
    count = loaded.study.trials.count
    wanted = sum(map(share.has, range(len(loaded.arms) * count)))
    lacking, aborted = wanted - len(rows), sum(not row.complete for row in rows)
    if aborted:
        print(f"{aborted} trials aborted", file=sys.stderr)
    if lacking > 0:
        how = "the same command without --merge" if report is None else "the same command"
        print(f"{lacking} of {wanted} trials are lacking; go on with {how}", file=sys.stderr)
    if stopped:
        print("interrupted", file=sys.stderr)
        return Exit.INTERRUPTED
    return Exit.FAILED if lacking > 0 or aborted else Exit.DONE


def _listed(older: "Mapping[str, int]", most: int = 4) -> str:
    """Return the arms with trials of older code, the first few by name."""
    more = f" and {len(older) - most} more arms" if len(older) > most else ""
    return ", ".join(f"{name} ({n})" for name, n in list(older.items())[:most]) + more
