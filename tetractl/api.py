"""Functions of `import tetractl`, for notebooks and scripts.

    specs        load_spec, parse_spec, experiment_schema
    simulation   run_trial, run_batch, run_study; open_trial, for a script that steers by itself
    reading      read_log, read_batch; to_arrays, to_dataframe
    checking     verify, summarise, compare
    drawing      plot, show, play_page

A function that needs a spec, a trial or a batch also accepts its file or folder. Slow libraries
(numba, matplotlib, pandas) are imported by the functions that need them. No function drives a lab:
only commands do, because their user can stop the robots.
"""

import logging
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np
from numpy.typing import NDArray

from tetractl.core.clock import MILLISECOND
from tetractl.core.errors import UsageError, demand, whole_number
from tetractl.core.poses import Bools, Floats
from tetractl.core.protocols import Observer
from tetractl.core.trial import Result
from tetractl.log.read.trial_log import TrialLog
from tetractl.spec import load
from tetractl.spec.loaded_spec import LoadedSpec

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from tetractl.report.html_page import FramedPage
    from tetractl.run.batch import Ending, RunObserver
    from tetractl.run.interrupt import Interrupt
    from tetractl.run.open_trial import OpenTrial
    from tetractl.run.task import Task
    from tetractl.statistics.describe import BatchComparison, BatchStatistics
    from tetractl.statistics.open_batch import Batch, Batches
    from tetractl.verification.verify import Verification
    from tetractl.view.video import Video

Strings = NDArray[np.str_]


# ---- Specs ----


def load_spec(path: str | Path, *sets: str) -> LoadedSpec:
    """Read a spec from a YAML file and check it.

    Args:
        path: The YAML file.
        *sets: Values that replace those in the file, such as "trials.count=5".

    Returns:
        The checked spec. Its attribute `experiment` holds the fields.

    Raises:
        SpecError: If the spec is wrong. The message has one line per problem.

    Example:
        >>> spec = tetractl.load_spec("experiments/single_cell.yaml", "trials.count=2")
        >>> spec.experiment.trials.count
        2
    """
    demand(path, str | Path, "load_spec reads a file, parse_spec a dict")
    _demand_texts(sets)
    return load.load_spec(Path(path), sets)


def parse_spec(text: str | Mapping[str, Any], *sets: str) -> LoadedSpec:
    """Check a spec that is given as YAML text or as a mapping.

    Args:
        text: The contents of a spec: YAML text, or a mapping such as `yaml.safe_load` returns.
        *sets: Values that replace those in the contents, such as "trials.count=5".

    Returns:
        The checked spec. Its attribute `experiment` holds the fields.

    Raises:
        SpecError: If the spec is wrong. The message has one line per problem.

    Example:
        >>> text = Path("experiments/single_cell.yaml").read_text()
        >>> tetractl.parse_spec(text).experiment.name
        'single-cell'
    """
    _demand_texts(sets)
    if isinstance(text, Mapping):
        return load.parse_contents(text, "spec", sets)
    demand(text, str, "the contents of a spec are a text or a dict")
    return load.parse_spec(text, "spec", sets)


def experiment_schema() -> dict[str, Any]:
    """Return the JSON schema of a spec, including the kinds that installed packages add.

    Example:
        >>> tetractl.experiment_schema()["required"]
        ['name', 'arena', 'robots']
    """
    from tetractl.spec.experiment import Experiment
    from tetractl.spec.schema import schema_of

    return schema_of(Experiment)


Spec = LoadedSpec | str | Path | Mapping[str, Any]
"""An experiment: a loaded spec, a YAML file, or the contents of one."""


def _spec(spec: Spec) -> LoadedSpec:
    """Load a spec that is given as a file or as contents; return a loaded spec unchanged."""
    if isinstance(spec, LoadedSpec):
        return spec
    if isinstance(spec, Mapping):
        return parse_spec(spec)
    demand(spec, str | Path, "a spec is a file, a dict or what load_spec returns")
    return load_spec(spec)


def _demand_texts(sets: Sequence[str]) -> None:
    for setting in sets:
        demand(setting, str, 'a setting is a text such as "trials.count=5"')


# ---- Simulating ----


def run_trial(
    spec: Spec,
    trial: int = 0,
    *,
    folder: str | Path | None = None,
    observers: Sequence[Observer] = (),
) -> TrialLog:
    """Simulate one trial and return it.

    The spec's seed and `trial` determine every random draw. If code must be compiled first, a line
    on stderr says so.

    Args:
        spec: The experiment: a loaded spec, a YAML file, or its contents.
        trial: Index of the trial, from 0. Trial 0 is logged to trial-000.mcap.
        folder: Where to keep the log. By default, the log is discarded.
        observers: Observers that watch the trial while it runs.

    Returns:
        The trial, as `read_log` returns it.

    Raises:
        SpecError: If the spec is wrong.
        UsageError: If the spec's plant is the lab, or if the log already exists.
        KeyboardInterrupt: After Ctrl-C has ended the trial.

    Example:
        >>> trial = tetractl.run_trial("experiments/single_cell.yaml")
        >>> trial.result.outcome.value
        'arrived'
    """
    from tetractl.log.read.reader import read_trial
    from tetractl.run import spec_trial
    from tetractl.run.folder_lock import make_folder

    spec = _spec(spec)
    trial = whole_number(trial, "a trial")
    if folder is not None:
        demand(folder, str | Path, "a folder is a path")
    _check(spec, _announcer(True))
    with TemporaryDirectory() as temporary, _interruptible() as interrupt:
        place = Path(temporary if folder is None else folder)
        path = spec_trial.log_path(place, trial)
        if path.exists():
            raise UsageError(f"{path}: exists already", "name another folder")
        make_folder(place)
        spec_trial.run_logged(spec, place, trial, observers, interrupt)
        simulated = read_trial(path)
    if folder is None:  # the file is gone
        return replace(simulated, log=f"{spec.name}, trial {trial}")
    return simulated


def open_trial(spec: Spec, trial: int = 0, seed: int | None = None) -> "OpenTrial":
    """Open a simulated trial that your script steers, one control step at a time.

    Call `step` with a direction until `result` is no longer None. `observation` is the newest
    camera frame, and `save` writes a log like any other. The trial is the same as one of the
    controller `sequence` with the directions that the script has sent.

    Args:
        spec: The experiment: a loaded spec, a YAML file, or its contents.
        trial: Index of the trial, from 0. It selects the random draws, together with the seed.
        seed: Seed to use instead of the spec's. None keeps the spec's seed.

    Raises:
        SpecError: If the controller `sequence` cannot run the spec, for example because of a hold.
        UsageError: If the spec's plant is the lab.

    Example:
        >>> trial = tetractl.open_trial("experiments/single_cell.yaml")
        >>> observation = trial.step(0.5)  # steer by 0.5 rad for one control step
        >>> trial.stop().outcome.value
        'sequence completed'
    """
    from tetractl.run.open_trial import OpenTrial

    opened = stepped(spec)
    return OpenTrial(opened, trial, opened.experiment.trials.seed if seed is None else seed)


def stepped(spec: Spec) -> LoadedSpec:
    """Return a spec for trials that a script steps, checked and compiled.

    It raises the same errors as `open_trial`.
    """
    from tetractl.run.open_trial import directed_spec

    loaded = _spec(spec)
    if loaded.experiment.plant.real_time:
        raise UsageError(
            "the spec's plant is the lab, which no script drives", "use `tetractl run`"
        )
    opened = directed_spec(loaded)
    _check(opened, _announcer(True))
    return opened


def _ignore(trial: int, result: Result) -> None:
    """Do nothing with a result."""


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
    from tetractl.run.executors import on_this_machine
    from tetractl.run.store import Store
    from tetractl.run.task import batch_tasks
    from tetractl.view.terminal.progress import progress_of_script

    spec = _spec(spec)
    demand(folder, str | Path, "a folder is a path")
    store = Store.of_batch(Path(folder), spec.experiment)
    _check(spec, _announcer(progress))
    after = f"read_batch({str(folder)!r}) reads the trials that ended; resume=True runs the others"
    with _interruptible(after) as interrupt, store.opened(resume):
        todo = store.lacking
        tasks = batch_tasks(spec, todo)
        executor = on_this_machine(jobs, len(todo), interrupt)
        watcher = _Watcher(on_result, progress_of_script(len(todo)) if progress else None)
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
    from tetractl.run.executors import on_this_machine
    from tetractl.statistics.open_batch import Batches
    from tetractl.study import arm_table, figure, missing_trials
    from tetractl.study.load_study import load_study
    from tetractl.view.terminal.progress import progress_of_script

    if folder is not None:
        demand(folder, str | Path, "a folder is a path")
    if not isinstance(study, Mapping):
        demand(study, str | Path, "a study is a file or a dict")
        study = Path(study)
    loaded = load_study(study)
    store = loaded.store(Path("logs", loaded.study.name) if folder is None else Path(folder))
    after = (
        f"read_batch({str(store.folder)!r}) reads the trials that ended; "
        "the same call runs the others"
    )
    with store.opened(), _interruptible(after) as interrupt:
        tasks, _ = missing_trials.lacking(loaded, store, rerun_outdated=False)
        missing_trials.warm_up_arms(loaded, _announcer(progress))
        executor = on_this_machine(jobs, len(tasks), interrupt)
        watcher = _Watcher(_ignore, progress_of_script(len(tasks)) if progress else None)
        report = batch.run_batch(tasks, store, executor, watcher)
        arm_table.write_table(loaded, store)
        figure.write_figures(loaded, store)
    for error in report.errors.values():
        raise error
    return Batches({arm.name: read_batch(store.folder / arm.name) for arm in loaded.arms})


def _check(spec: LoadedSpec, announce: Callable[[str], None]) -> None:
    """Check that a spec can be simulated, log its warnings, and compile its kernels.

    `announce` is called with a line of text before anything is compiled.
    """
    from tetractl.control.methods.build import warm_up
    from tetractl.run.plausibility import find_warnings

    experiment = spec.experiment
    if experiment.plant.real_time:
        raise UsageError(
            "the spec's plant is the lab, which this function does not drive", "use `tetractl run`"
        )
    for warning in find_warnings(spec):
        logging.getLogger("tetractl").warning("warning: %s", warning)
    warm_up(experiment, announce)


def _announcer(progress: bool) -> Callable[[str], None]:
    """Return the function that announces compiling.

    The function prints to stderr if `progress` is True. Otherwise, it logs at level INFO.
    """
    if progress:
        return partial(print, file=sys.stderr, flush=True)
    return logging.getLogger("tetractl").info


@contextmanager
def _interruptible(after: str = "") -> "Iterator[Interrupt]":
    """Count signals such as Ctrl-C during the `with` block, and raise KeyboardInterrupt after it.

    Nothing is raised if no signal arrived. `after` is the error's message: what can be done now.
    """
    from tetractl.run.interrupt import Interrupt

    interrupt = Interrupt()
    if threading.current_thread() is threading.main_thread():
        with interrupt.watch():
            yield interrupt
    else:  # only the main thread receives signals
        yield interrupt
    if interrupt.requested:
        raise KeyboardInterrupt(after) if after else KeyboardInterrupt


@dataclass(frozen=True, slots=True)
class _Watcher:
    """An observer of a run that shows its progress and calls `on_result` for each trial."""

    on_result: Callable[[int, Result], object]
    progress: "RunObserver | None" = None

    def trial_started(self, task: "Task") -> None:
        """Do nothing."""

    def trial_ended(self, ending: "Ending") -> None:
        """Show the progress, and call `on_result` with the trial's index and result."""
        if self.progress:
            self.progress.trial_ended(ending)
        if ending.result:
            self.on_result(ending.task.trial, ending.result)


# ---- Reading ----


Trial = TrialLog | str | Path
"""A trial, or its log."""


def read_log(path: str | Path) -> TrialLog:
    """Read a trial from its log.

    If the log is damaged, the intact part is read, and the trial's `damage` describes what is
    missing.

    Args:
        path: The log, a file such as trial-000.mcap.

    Raises:
        LogError: If nothing can be read.

    Example:
        >>> trial = tetractl.read_log("logs/cell/trial-000.mcap")
        >>> f"{trial.result.duration_s:.1f} s"
        '7.6 s'
    """
    from tetractl.log.read.reader import read_trial

    demand(path, str | Path, "read_log reads the file of a log")
    return read_trial(Path(path))


def read_batch(*paths: str | Path) -> "Batch":
    """Read the results of many trials, at about a millisecond per log.

    Args:
        *paths: Logs, folders of logs, or patterns such as "logs/cell/trial-00*.mcap".

    Returns:
        A batch. It has the `trials`, the earlier `attempts` at them, and the `damaged` logs.

    Raises:
        UsageError: If a path holds no trial.

    Example:
        >>> batch = tetractl.read_batch("logs/cell")
        >>> [trial.outcome.value for trial in batch.trials]
        ['arrived', 'arrived', 'arrived']
    """
    from tetractl.statistics.open_batch import open_batch

    if not paths:
        raise UsageError("no log is given")
    for path in paths:
        demand(path, str | Path, "read_batch reads logs, folders and patterns")
    return open_batch(paths)


def _trial(trial: Trial) -> TrialLog:
    if isinstance(trial, TrialLog):
        return trial
    demand(trial, str | Path, "a trial is a log's file, or what read_log returns")
    return read_log(trial)


def _batch(batch: "Batch | str | Path | Sequence[str | Path]") -> "Batch":
    """Return a batch that is given as a folder, as paths of logs, or already read."""
    from tetractl.statistics.open_batch import Batch

    if isinstance(batch, Batch):
        return batch
    if isinstance(batch, str | Path):
        return read_batch(batch)
    demand(batch, Iterable, "a batch is a folder, paths of logs or what read_batch returns")
    return read_batch(*batch)


def _trials(data: "Trial | Sequence[Trial] | Batch") -> list[TrialLog]:
    """Read the trials that are given as one trial, several, a batch, or a folder."""
    from tetractl.statistics.open_batch import Batch

    if isinstance(data, str | Path) and Path(data).is_dir():
        data = read_batch(data)
    if isinstance(data, Batch):
        return [read_log(trial.log) for trial in data.trials]
    if isinstance(data, TrialLog | str | Path):
        return [_trial(data)]
    demand(data, Iterable, "what is drawn is a trial, a list of them, a batch or its statistics")
    trials = [_trial(trial) for trial in data]
    if not trials:
        raise UsageError("no trial to draw is given")
    return trials


@dataclass(frozen=True, slots=True, eq=False)
class TrialArrays:
    """A trial of M camera frames, K control steps and N robots, as arrays.

    Times count from the first direction that was sent.

    Attributes:
        unit: Length unit of the spec, such as "mm". Poses and distances use it.
        robots: Names of the robots, shape (N,).
        time_s: When each frame was exposed [s], shape (M,).
        frame: Number of each frame, shape (M,).
        poses: Measured poses, shape (M, N, 3): x and y [length unit], heading [rad].
        valid: Whether each robot was tracked, shape (M, N).
        truth: True poses, like `poses`. NaN if they are not known, as in a lab.
        distance: Distance from the measured position to the target [length unit], shape (M, N).
        step_time_s: When each command was sent [s], shape (K,).
        direction: The common direction u [rad], shape (K,). NaN while the field is off.
        cost: Cost J of the chosen sequence, equation (7) of the paper, shape (K,).
        length: Number of signals in the chosen sequence, shape (K,).
        evaluations: Number of costs evaluated, shape (K,).
        solve_ms: Wall time of the search [ms], shape (K,).
    """

    unit: str
    robots: Strings
    time_s: Floats = field(repr=False)
    frame: NDArray[np.int64] = field(repr=False)
    poses: Floats = field(repr=False)
    valid: Bools = field(repr=False)
    truth: Floats = field(repr=False)
    distance: Floats = field(repr=False)
    step_time_s: Floats = field(repr=False)
    direction: Floats = field(repr=False)
    cost: Floats = field(repr=False)
    length: NDArray[np.int64] = field(repr=False)
    evaluations: NDArray[np.int64] = field(repr=False)
    solve_ms: Floats = field(repr=False)


def to_arrays(trial: Trial) -> TrialArrays:
    """Convert a trial's poses, commands and decisions to NumPy arrays.

    Args:
        trial: A trial, or its log.

    Example:
        >>> arrays = tetractl.to_arrays("logs/cell/trial-000.mcap")
        >>> arrays.poses.shape  # camera frames, robots, (x, y, heading)
        (915, 1, 3)
    """
    trial = _trial(trial)
    setup = trial.start.setup
    steps = trial.steps
    unknown = np.full_like(trial.mocap, np.nan)
    return TrialArrays(
        unit=setup.unit,
        robots=np.array(setup.names),
        time_s=trial.frames_s,
        frame=trial.frames,
        poses=trial.mocap,
        valid=trial.valid,
        truth=unknown if trial.truth is None else trial.truth,
        distance=setup.distances(trial.mocap[..., :2]),
        step_time_s=trial.steps_s,
        direction=np.array([step.plan.direction for step in steps], dtype=float),
        cost=np.array([step.plan.cost for step in steps], dtype=float),
        length=np.array([len(step.plan.signals) for step in steps], dtype=np.int64),
        evaluations=np.array([step.plan.evaluations for step in steps], dtype=np.int64),
        solve_ms=np.array([step.solve_ns for step in steps], dtype=float) / MILLISECOND,
    )


def to_dataframe(data: "TrialLog | Batch | str | Path") -> "pandas.DataFrame":
    """Convert a trial or a batch to a pandas DataFrame.

    The columns are those of the tables `poses` and `trials` that `tetractl export` writes.

    Args:
        data: A trial or its log, or a batch or its folder.

    Returns:
        For a trial, one row for each frame and robot. `attrs["origin"]` names the plant, such as
        "emulated lab". For a batch, one row for each trial. The column `origin` names the plant,
        and `attempt` is True for earlier attempts at a trial.

    Raises:
        UsageError: If pandas is not installed.

    Example:
        >>> table = tetractl.to_dataframe("logs/cell")
        >>> len(table)
        3
    """
    try:
        import pandas
    except ModuleNotFoundError:
        raise UsageError(
            "a DataFrame needs pandas, which is not installed",
            "pip install pandas, or use to_arrays",
        ) from None
    from tetractl.statistics.trial_tables import poses, trials_table

    if isinstance(data, str | Path):
        is_folder = Path(data).is_dir()
        data = read_batch(data) if is_folder else read_log(data)
    if not isinstance(data, TrialLog):
        rows = trials_table(_batch(data))
        return pandas.DataFrame(rows.as_dict())
    frame = pandas.DataFrame(poses(data).as_dict())
    frame.attrs["origin"] = data.origin.value
    return frame


# ---- Checking ----


def verify(path: str | Path) -> "Verification":
    """Compute every decision in a log again, and check the log for contradictions.

    Args:
        path: The log of one trial.

    Returns:
        What was compared, and every difference. Its attribute `ok` is True if there is none.

    Raises:
        UsageError: If `path` is a folder.

    Example:
        >>> tetractl.verify("logs/cell/trial-000.mcap").ok
        True
    """
    from tetractl.verification import verify

    demand(path, str | Path, "verify reads the file of a log")
    if Path(path).is_dir():
        raise UsageError(
            f"{path}: is a folder, and verify reads one log",
            f"[verify(trial.log) for trial in read_batch({str(path)!r}).trials]",
        )
    return verify.verify(Path(path), _announcer(True))


def summarise(
    batch: "Batch | str | Path | Sequence[str | Path]", name: str = ""
) -> "BatchStatistics":
    """Compute the statistics of a batch: errors with intervals, outcomes, the published result.

    Args:
        batch: A batch, its folder, or the paths of its logs.
        name: The batch's name in tables and figures. By default, the experiment's name.

    Raises:
        UsageError: If the trials belong to different experiments.

    Example:
        >>> statistics = tetractl.summarise("logs/cell")
        >>> statistics.total.n
        3
    """
    from tetractl.statistics.describe import describe

    return describe(_batch(batch), name)


def compare(
    *batches: "BatchStatistics | Batch | str | Path | Sequence[str | Path]",
) -> "BatchComparison":
    """Compare the total errors of every pair of batches.

    Differences are the first batch minus the second. A batch is named after its folder, and
    statistics keep the name that `summarise` gave them.

    Args:
        *batches: Batches, their folders, the paths of their logs, or statistics from `summarise`.

    Example:
        >>> small, large = "logs/swarms/small", "logs/swarms/large"
        >>> comparison = tetractl.compare(small, large)
    """
    from tetractl.statistics.describe import BatchStatistics, contrast
    from tetractl.statistics.open_batch import Batch

    compared = list[BatchStatistics]()
    for batch in batches:
        if isinstance(batch, BatchStatistics):
            compared.append(batch)
        elif isinstance(batch, str | Path):
            compared.append(summarise(batch, Path(batch).name))
        elif isinstance(batch, Batch) and len({log.parent for log in batch.logs}) == 1:
            compared.append(summarise(batch, batch.logs[0].parent.name))
        else:
            compared.append(summarise(batch))
    return contrast(compared)


# ---- Drawing ----


@overload
def plot(  # pyright: ignore[reportOverlappingOverload] - every other text is a figure's
    data: "Trial", kind: Literal["video"], *, file: str | Path | None = None
) -> "Video": ...


@overload
def plot(
    data: "Trial | Sequence[Trial] | Batch | BatchStatistics | BatchComparison",
    kind: str = "trajectory",
    *,
    file: str | Path | None = None,
) -> "Figure": ...


def plot(
    data: "Trial | Sequence[Trial] | Batch | BatchStatistics | BatchComparison",
    kind: str = "trajectory",
    *,
    file: str | Path | None = None,
) -> "Figure | Video":
    """Draw a figure of trials or statistics with matplotlib, and optionally save it.

    Args:
        data: What to draw: a trial, several trials, a batch, statistics or a comparison. Logs and
            folders are read.
        kind: A figure of `tetractl plot`, such as "trajectory", or "video" for a video of one
            trial. The kinds "trajectory", "errors" and "batch" can show several trials. Statistics
            and comparisons are always drawn as "batch".
        file: Where to save the figure (.png, .svg, .pdf) or the video (.mp4, .gif, .webp). By
            default, it is not saved.

    Returns:
        The matplotlib figure, or the video.

    Raises:
        UsageError: If the kind is unknown, or cannot show this many trials.

    Example:
        >>> figure = tetractl.plot("logs/cell/trial-000.mcap", file="trial.png")
    """
    from tetractl.statistics.describe import BatchComparison, BatchStatistics
    from tetractl.view import style
    from tetractl.view.figures.batch import batch_figure
    from tetractl.view.figures.draw import draw

    if isinstance(data, BatchComparison):
        figure = batch_figure(data.groups)
    elif isinstance(data, BatchStatistics):
        figure = batch_figure([data])
    elif kind == "video":
        return _video(_trials(data), file)
    else:
        figure = draw(kind, _trials(data))
    if file is not None:
        style.save(figure, Path(file))
    return figure


def _video(trials: Sequence[TrialLog], file: str | Path | None) -> "Video":
    from tetractl.view.video import video

    if len(trials) > 1:
        raise UsageError(f"a video shows one trial, not {len(trials)}")
    return video(trials[0], None if file is None else Path(file))


def show(data: "Trial | Sequence[Trial] | Batch") -> "FramedPage":
    """Return the report's interactive player for one or more trials, for a notebook to display.

    Args:
        data: A trial or its log, several trials, a batch, or the folder of a batch.

    Example:
        >>> player = tetractl.show("logs/cell/trial-000.mcap")
    """
    from tetractl.report.page import player

    return player(_trials(data))


def play_page(spec: Spec, *, file: str | Path | None = None) -> "FramedPage":
    """Make a web page on which anybody can steer the robots of a spec by hand.

    The page needs no server and no network. Its robots follow the spec's model, without
    disturbances. The page also contains one trial of the spec's controller, which this function
    simulates.

    Args:
        spec: The experiment: a loaded spec, a YAML file, or its contents.
        file: Where to write the page (.html). By default, it is not written.

    Returns:
        The page, which a notebook shows. Its HTML is the attribute `page`.

    Raises:
        SpecError: If the spec has a hold or way-points, which cannot be played.
        UsageError: If a camera must first find the robots, or if they follow a motion that the page
            does not know.

    Example:
        >>> page = tetractl.play_page("experiments/single_cell.yaml", file="play.html")
    """
    from tetractl.report import play_page as page
    from tetractl.run.open_trial import directed_spec
    from tetractl.run.undisturbed import undisturbed_spec
    from tetractl.tools.files import save_whole

    if file is not None and not Path(file).absolute().parent.is_dir():
        raise UsageError(f"{file}: there is no folder {Path(file).parent}")
    undisturbed = undisturbed_spec(_spec(spec))
    directed_spec(undisturbed)  # refuses what cannot be steered by hand
    page.refuse_unknown_motion(undisturbed)
    made = page.play_page(undisturbed, run_trial(undisturbed))
    if file is not None:
        save_whole(Path(file), made.page.encode())
    return made
