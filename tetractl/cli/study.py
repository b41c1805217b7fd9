"""`tetractl study`: runs arms of trials with the same seeds, on this machine or a cluster."""

import os
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tetractl.cli import ui
from tetractl.cli.options import argument, option, out_option, switch
from tetractl.cli.unread import notice_of_signals
from tetractl.core.errors import Exit, UsageError
from tetractl.core.table.terminal_table import print_tables
from tetractl.run.interrupt import Interrupt, leave_on_signals

if TYPE_CHECKING:
    from tetractl.run.store import Store
    from tetractl.study.load_study import LoadedStudy

STOPPING = b"\nstopping after the steps that run; a second Ctrl-C stops at once\n"


def study(
    file: Annotated[Path, argument("STUDY", "The study, a YAML file.")],
    out: Annotated[
        Path | None, out_option("DIR", "Folder of the study. [logs/<study name>]")
    ] = None,
    jobs: Annotated[
        int | None,
        option("N", "Number of trials run at a time, each in its own process. [processors]", min=1),
    ] = None,
    logs: Annotated[
        str,
        option("all|failed|sample:N|none", "Trials whose logs are whole, not brief."),
    ] = "all",
    fail_fast: Annotated[
        bool, switch("Stop at the first trial that fails.", "--fail-fast")
    ] = False,
    rerun_outdated: Annotated[
        bool,
        switch(
            "Run again the trials that another version of the code has run.",
            "--rerun-outdated",
        ),
    ] = False,
    cluster: Annotated[
        str | None, option("ADDRESS", "Run on the Dask cluster with the scheduler at this address.")
    ] = None,
    dry_run: Annotated[
        bool,
        switch(
            "Run nothing: print the arms and how many of their trials would be run.", "--dry-run"
        ),
    ] = False,
    quiet: Annotated[bool, switch("Print only failures.", "--quiet", "-q")] = False,
) -> int:
    """Run every arm of a study with the same seeds; write a table, and figures.

    If a study was interrupted, the same command runs the missing trials. A trial that fails does
    not stop the others; the exit code is then 1.

    Example: tetractl study experiments/studies/dead_time.yaml --logs none
    """
    from rich.console import Console

    from tetractl.run.batch import run_batch
    from tetractl.run.cluster import Cluster
    from tetractl.run.executors import on_this_machine
    from tetractl.study import options
    from tetractl.study.load_study import load_study
    from tetractl.view.terminal.progress import StudyProgress

    if cluster is not None and jobs is not None:
        raise UsageError("--jobs is for this machine, --cluster for others: give one of them")
    rule = options.Logs.parse(logs)
    loaded = load_study(file)
    folder = out or Path("logs") / loaded.study.name
    ui.tell_of_earlier_rows(folder, "trials.jsonl")
    store = loaded.store(folder)
    if dry_run:
        store.read()
        tasks, _ = options.lacking(loaded, store, rule, rerun_outdated)
        print_tables([options.dry_run(loaded, folder, tasks)])
        return Exit.DONE
    with store.opened():
        tasks, outdated = options.lacking(loaded, store, rule, rerun_outdated)
        if outdated:
            named = [f"{name} ({n})" for name, n in outdated.items()]
            more = f" and {len(named[4:])} more arms" if named[4:] else ""
            ui.tell(
                f"notice: {sum(outdated.values())} trials were run by outdated code and are kept:"
                f" {', '.join(named[:4])}{more}; run them again with --rerun-outdated"
            )
        interrupt = Interrupt(notice_of_signals(STOPPING))
        if cluster is None and tasks:
            options.warm_up_arms(loaded, partial(ui.announce_compiling, quiet))
        found = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
        here = on_this_machine(jobs or found or 1, len(tasks), interrupt)
        leave_on_signals(Exit.INTERRUPTED)
        with Cluster(cluster, interrupt) if cluster is not None else nullcontext(here) as executor:
            if not quiet:
                arms, count = len(loaded.arms), loaded.study.trials.count
                ui.tell(
                    f"{loaded.study.name}: {arms} arms of {count} trials, {len(tasks)} of"
                    f" {arms * count} to run, {executor.workers} at a time"
                )
            shown = StudyProgress(Console(stderr=True), len(tasks), quiet)
            with interrupt.watch(), shown as progress:
                run_batch(tasks, store, executor, progress, fail_fast)
        return _conclude(loaded, store, interrupt.requested)


def _conclude(loaded: "LoadedStudy", store: "Store", stopped: bool) -> int:
    """Write tables and figures; print the errors and the number of missing trials; return the exit
    code.
    """
    from tetractl.study.arm_table import arms_table, finished_trials, write_tables
    from tetractl.study.figure import write_figures

    finished = [trial for _, trial in finished_trials(loaded, store)]
    if finished:
        paths = [*write_tables(loaded, store), *write_figures(loaded, store)]
        print_tables([arms_table(loaded, store)])
        print(*paths, sep="\n")
    wanted = len(loaded.arms) * loaded.study.trials.count
    lacking, aborted = wanted - len(finished), sum(not t.outcome.complete for t in finished)
    if aborted:
        ui.tell(f"{aborted} trials aborted")
    if lacking > 0:
        ui.tell(f"{lacking} of {wanted} trials are missing; continue with the same command")
    if stopped:
        ui.tell("interrupted")
        return Exit.INTERRUPTED
    return Exit.FAILED if lacking > 0 or aborted else Exit.DONE
