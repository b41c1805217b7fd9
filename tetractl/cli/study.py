"""The command `tetractl study`, which runs many variants of an experiment (its arms).

All arms have the same seeds. Trials run on this machine or on a cluster.
"""

import os
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tetractl.cli import ui
from tetractl.cli.options import argument, option, out_option, switch
from tetractl.cli.unread import create_signal_notice
from tetractl.core.errors import Exit, UsageError
from tetractl.run.interrupt import Interrupt, leave_on_signals
from tetractl.tools.table.terminal_table import open_console, print_tables

if TYPE_CHECKING:
    from tetractl.run.store import Store
    from tetractl.run.task import Task
    from tetractl.study.load_study import LoadedStudy

STOPPING_NOTICE = b"\nstopping after the steps that run; a second Ctrl-C stops at once\n"
"""Printed by the handler of the first signal."""
ARMS_NAMED = 4
"""Maximum number of arms that the notice of outdated trials names."""


def study(
    file: Annotated[Path, argument("STUDY", "The study, a YAML file.")],
    out: Annotated[
        Path | None, out_option("DIR", "Folder for the study's results. [logs/<study name>]")
    ] = None,
    jobs: Annotated[
        int | None,
        option(
            "N",
            "Number of trials to run at the same time, each in its own process. [processors]",
            min=1,
        ),
    ] = None,
    fail_fast: Annotated[
        bool, switch("Stop at the first trial that fails.", "--fail-fast")
    ] = False,
    rerun_outdated: Annotated[
        bool,
        switch(
            "Also rerun trials that were run with another version of the code.",
            "--rerun-outdated",
        ),
    ] = False,
    cluster: Annotated[
        str | None, option("ADDRESS", "Run on the Dask cluster with the scheduler at this address.")
    ] = None,
    dry_run: Annotated[
        bool,
        switch(
            "Run nothing. Print the arms, and how many of their trials would be run.", "--dry-run"
        ),
    ] = False,
    quiet: Annotated[
        bool,
        switch("Show no progress. Print only failures, the table and the files.", "--quiet", "-q"),
    ] = False,
) -> int:
    """Run every arm of a study with the same seeds; write a table, and figures.

    If a study was interrupted, the same command runs the missing trials and draws the figures. A
    trial that fails does not stop the others; the exit code is then 1.

    Example: tetractl study experiments/studies/dead_time.yaml
    """
    from tetractl.study import missing_trials
    from tetractl.study.load_study import load_study

    if cluster is not None and jobs is not None:
        raise UsageError("--jobs uses this computer and --cluster others: give only one of them")
    loaded = load_study(file)
    folder = out or Path("logs") / loaded.study.name
    store = loaded.store(folder)
    if dry_run:
        store.read()
        tasks, _ = missing_trials.unfinished_tasks(loaded, store, rerun_outdated)
        print_tables([missing_trials.dry_run(loaded, folder, tasks)])
        return Exit.DONE
    with store.opened():
        tasks, outdated = missing_trials.unfinished_tasks(loaded, store, rerun_outdated)
        _report_outdated(outdated)
        interrupted = _run_tasks(loaded, store, tasks, jobs, cluster, fail_fast, quiet)
        return _conclude(loaded, store, interrupted)


def _report_outdated(outdated: Mapping[str, int]) -> None:
    """Print how many trials of each arm are kept although an older version of the code ran them."""
    if not outdated:
        return
    names = [f"{arm} ({count})" for arm, count in outdated.items()]
    unnamed = len(names) - ARMS_NAMED
    unnamed_note = f" and {unnamed} more arms" if unnamed > 0 else ""
    ui.print_messages(
        f"notice: {sum(outdated.values())} trials were run by outdated code and are kept:"
        f" {', '.join(names[:ARMS_NAMED])}{unnamed_note}; run them again with --rerun-outdated"
    )


def _run_tasks(
    loaded: "LoadedStudy",
    store: "Store",
    tasks: "Sequence[Task]",
    jobs: int | None,
    cluster: str | None,
    fail_fast: bool,
    quiet: bool,
) -> bool:
    """Run the trials of a study, and show their progress on stderr.

    Returns:
        Whether a signal stopped the trials.
    """
    from tetractl.run.batch import OnFailure, run_batch
    from tetractl.run.cluster import Cluster
    from tetractl.run.executors import local_executor
    from tetractl.study.missing_trials import warm_up_arms
    from tetractl.view.terminal.progress import StudyProgress

    interrupt = Interrupt(create_signal_notice(STOPPING_NOTICE))
    if cluster is not None:
        executor_context = Cluster(cluster, interrupt)
    else:
        if tasks:
            warm_up_arms(loaded, partial(ui.announce_compiling, quiet))
        processors = os.cpu_count() or 1
        if hasattr(os, "sched_getaffinity"):  # Linux only
            processors = len(os.sched_getaffinity(0))
        executor_context = nullcontext(local_executor(jobs or processors, len(tasks), interrupt))
    leave_on_signals(Exit.INTERRUPTED)  # for signals that arrive outside of `watch`
    with executor_context as executor:
        if not quiet:
            arms = len(loaded.arms)
            count = loaded.study.trials.count
            ui.print_messages(
                f"{loaded.study.name}: {arms} arms of {count} trials, {len(tasks)} of "
                f"{arms * count} to run, {executor.workers} at a time"
            )
        display = StudyProgress(open_console(stderr=True), len(tasks), quiet)
        with interrupt.watch(), display as progress:
            on_failure = OnFailure.END if fail_fast else OnFailure.GO_ON
            run_batch(tasks, store, executor, progress, on_failure)
    return interrupt.requested


def _conclude(loaded: "LoadedStudy", store: "Store", interrupted: bool) -> int:
    """Write the table and the figures of a study, and print its errors.

    Figures take seconds, and are left out if the study was interrupted. The number of missing
    trials is also printed. The result is the exit code.
    """
    from tetractl.study.arm_table import arms_table, finished_trials, write_table

    finished = [trial for _, trial in finished_trials(loaded, store)]
    if finished:
        paths = [write_table(loaded, store)]
        if not interrupted:
            from tetractl.study.figure import write_figures

            paths += write_figures(loaded, store)
        print_tables([arms_table(loaded, store)])
        print(*paths, sep="\n")
    trial_count = len(loaded.arms) * loaded.study.trials.count
    missing_count = trial_count - len(finished)
    aborted = sum(not trial.outcome.complete for trial in finished)
    if aborted:
        ui.print_messages(f"{aborted} trials aborted")
    if missing_count > 0:
        ui.print_messages(
            f"{missing_count} of {trial_count} trials are missing; to continue, run the same "
            "command again"
        )
    if interrupted:
        ui.print_messages("interrupted")
        return Exit.INTERRUPTED
    return Exit.FAILED if missing_count > 0 or aborted else Exit.DONE
