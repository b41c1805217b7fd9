"""Functions of the Python interface that simulate batches of trials, and studies."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tetractl.api.logs import read_batch
from tetractl.api.preparation import announcer, check_simulated, interruptible
from tetractl.api.specs import Spec, as_spec
from tetractl.core.errors import require_type
from tetractl.core.trial import Result

if TYPE_CHECKING:
    from tetractl.run.batch import Ending, RunObserver
    from tetractl.run.task import Task
    from tetractl.statistics.open_batch import Batch, Batches


def _ignore(trial: int, result: Result) -> None:
    """Do nothing with a result.

    This is the default for a function that is called with each result.
    """


def run_batch(
    spec: Spec,
    folder: str | Path,
    *,
    jobs: int = 1,
    resume: bool = False,
    on_result: Callable[[int, Result], object] = _ignore,
    progress: bool = True,
) -> "Batch":
    """Simulate all trials of a spec and return their results.

    The logs are written to trial-000.mcap, trial-001.mcap and so on. An aborted trial ends the
    batch. In an emulated lab, it does so only if a person would have to touch a robot or a device.

    Args:
        spec: The experiment: a loaded spec, a YAML file, or its contents.
        folder: Where to write the logs.
        jobs: How many trials to run at the same time, each in its own process.
        resume: Whether to run only the trials that the folder lacks. If False, a folder that
            already holds logs is refused.
        on_result: Called with the index and the result of each trial that has ended.
        progress: Whether to print to stderr what is compiled and how many trials have ended.

    Returns:
        The trials in the folder, as `read_batch` returns them.

    Raises:
        SpecError: If the spec is wrong.
        UsageError: If the spec's plant is the lab, or if the folder already holds logs.
        KeyboardInterrupt: After Ctrl-C has ended the batch.

    Example:
        >>> spec = tetractl.load_spec("experiments/single_cell.yaml", "trials.count=3")
        >>> batch = tetractl.run_batch(spec, "logs/cell")
        >>> len(batch.trials)
        3
    """
    from tetractl.run import batch
    from tetractl.run.executors import local_executor
    from tetractl.run.store import Store
    from tetractl.run.task import batch_tasks
    from tetractl.view.terminal.progress import create_script_progress

    spec = as_spec(spec)
    require_type(folder, str | Path, "the folder must be a path")
    store = Store.of_batch(Path(folder), spec.experiment)
    check_simulated(spec, announcer(progress))
    after = (
        f"`read_batch({str(folder)!r})` reads the trials that have ended; with "
        "resume=True, this function runs the others"
    )
    with interruptible(after) as interrupt, store.opened(resume):
        todo = store.unfinished
        tasks = batch_tasks(spec, todo)
        executor = local_executor(jobs, len(todo), interrupt)
        watcher = _Watcher(on_result, create_script_progress(len(todo)) if progress else None)
        on_failure = batch.OnFailure.of_batch(spec.experiment.plant)
        report = batch.run_batch(tasks, store, executor, watcher, on_failure)
    for error in report.errors.values():
        raise error
    return read_batch(store.folder)


def run_study(
    study: str | Path | Mapping[str, Any],
    folder: str | Path | None = None,
    *,
    jobs: int = 1,
    progress: bool = True,
) -> "Batches":
    """Simulate the trials of a study that its folder lacks, and write its tables and figures.

    A trial that fails does not stop the others. Its error is raised at the end.

    Args:
        study: A YAML file, or its contents. In contents, `base` is a spec's file or contents.
        folder: Where to write the logs, tables and figures. By default, logs/NAME.
        jobs: How many trials to run at the same time, each in its own process.
        progress: Whether to print to stderr what is compiled and how many trials have ended.

    Returns:
        The results of each arm, by the arm's name.

    Raises:
        SpecError: If the study or its base is wrong.
        UsageError: If an argument is wrong.
        KeyboardInterrupt: After Ctrl-C has ended the study.

    Example:
        >>> arms = {"small": {}, "large": {"controller.optimizer.particles": 80}}
        >>> base = "experiments/single_cell.yaml"
        >>> study = {"name": "swarms", "base": base, "controllers": arms, "trials": {"count": 2}}
        >>> list(tetractl.run_study(study, "logs/swarms"))
        ['small', 'large']
    """
    from tetractl.run import batch
    from tetractl.run.executors import local_executor
    from tetractl.statistics.open_batch import Batches
    from tetractl.study import arm_table, figure, missing_trials
    from tetractl.study.load_study import load_study
    from tetractl.view.terminal.progress import create_script_progress

    if folder is not None:
        require_type(folder, str | Path, "the folder must be a path")
    if not isinstance(study, Mapping):
        require_type(study, str | Path, "a study must be a file or a dict")
        study = Path(study)
    loaded = load_study(study)
    store = loaded.store(Path("logs", loaded.study.name) if folder is None else Path(folder))
    after = (
        f"`read_batch({str(store.folder)!r})` reads the trials that have ended; the same "
        "call of `run_study` runs the others"
    )
    with store.opened(), interruptible(after) as interrupt:
        tasks, _ = missing_trials.unfinished_tasks(loaded, store, rerun_outdated=False)
        missing_trials.warm_up_arms(loaded, announcer(progress))
        executor = local_executor(jobs, len(tasks), interrupt)
        watcher = _Watcher(_ignore, create_script_progress(len(tasks)) if progress else None)
        report = batch.run_batch(tasks, store, executor, watcher)
        arm_table.write_table(loaded, store)
        figure.write_figures(loaded, store)
    for error in report.errors.values():
        raise error
    return Batches({arm.name: read_batch(store.folder / arm.name) for arm in loaded.arms})


@dataclass(frozen=True, slots=True)
class _Watcher:
    """An observer of a run that shows its progress and calls `on_result` for each trial."""

    on_result: Callable[[int, Result], object]
    progress: "RunObserver | None" = None

    def trial_started(self, task: "Task") -> None:
        """Do nothing when a trial starts. Only the ends of trials are reported."""

    def trial_ended(self, ending: "Ending") -> None:
        """Show the progress, and call `on_result` with the trial's index and result.

        `on_result` is not called for a trial that ended without a result.
        """
        if self.progress:
            self.progress.trial_ended(ending)
        if ending.result:
            self.on_result(ending.task.trial, ending.result)
