"""The functions of `import tetractl`, for notebooks and scripts.

    specs        load_spec, parse_spec, experiment_schema
    simulating   run_trial, run_batch, run_study; open_trial, for a script that decides itself
    reading      read_log, read_batch; to_arrays, to_dataframe
    checking     verify, summarise, compare
    drawing      plot, show

Where a spec, a trial or a batch is needed, its file or folder will do. Slow libraries (numba,
matplotlib, pandas) are imported by the functions that need them. None drives a lab: only commands
do, because their user can stop the robots.
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
    """Read and check a spec file; `sets`, such as "trials.count=5", replace its values.

    Raises SpecError with one line per problem.
    """
    demand(path, str | Path, "load_spec reads a file, parse_spec a dict")
    _demand_texts(sets)
    return load.load_spec(Path(path), sets)


def parse_spec(text: str | Mapping[str, Any], *sets: str) -> LoadedSpec:
    """Check a spec given as YAML text or as a mapping; `sets` and errors are as in `load_spec`."""
    _demand_texts(sets)
    if isinstance(text, Mapping):
        return load.parse_contents(text, "spec", sets)
    demand(text, str, "the contents of a spec are a text or a dict")
    return load.parse_spec(text, "spec", sets)


def experiment_schema() -> dict[str, Any]:
    """Return the JSON schema of a spec, with the kinds that installed packages add."""
    from tetractl.spec.experiment import Experiment
    from tetractl.spec.schema import schema_of

    return schema_of(Experiment)


Spec = LoadedSpec | str | Path | Mapping[str, Any]
"""A spec, its file, or its contents."""


def _spec(spec: Spec) -> LoadedSpec:
    """Return a spec that is loaded, given as a file, or as the contents of one."""
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
    """Simulate one trial and return it; its log is kept only if a `folder` is given.

    `trial` counts from 0; the log of trial 0 is trial-000.mcap. The spec's seed and `trial`
    determine every random draw. `observers` watch the trial. If code must be compiled first, a line
    on stderr says so. Raises UsageError for a spec whose
    plant is the lab and for a log that exists already, KeyboardInterrupt after Ctrl-C has ended the
    trial.
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
    """Return a simulated trial that a script steps: it asks for a direction at each control step.

    It is the trial of the controller `sequence` with the directions sent: `step` sends one,
    `observation` is the newest camera frame, `result` is there once the trial has ended, and `save`
    writes a log like any other. `seed` replaces the spec's. Raises SpecError for what `sequence`
    refuses, such as a hold, and UsageError for a lab.
    """
    from tetractl.run.open_trial import OpenTrial

    opened = stepped(spec)
    return OpenTrial(opened, trial, opened.experiment.trials.seed if seed is None else seed)


def stepped(spec: Spec) -> LoadedSpec:
    """Return a spec for trials that a script steps, checked and compiled; errors are those of
    `open_trial`."""
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
    """Simulate all trials of a spec, `jobs` at a time, and return the results in the folder.

    The logs are trial-000.mcap and so on. `resume` runs only the trials that the folder lacks;
    without it, a folder that holds logs is refused. `on_result` is called with each trial's number
    and result. `progress` prints to stderr what is compiled and, now and then, how many trials have
    ended. An aborted trial ends the batch; in an emulated lab only if somebody would have to touch
    a robot or a device. Errors are those of `run_trial`.
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
    logs: Literal["all", "none"] = "all",
    progress: bool = True,
) -> "Batches":
    """Simulate the trials of a study that its folder lacks, write its tables and figures, and
    return the results of each arm by the arm's name.

    The study is a file, or its contents; the `base` of contents is a file or a spec's contents. The
    folder is logs/NAME if none is given; `logs` says which trials have whole logs, not brief ones.
    A trial that fails does not stop the others; its error is raised at the end. `progress` and
    errors are those of `run_batch`.
    """
    from tetractl.run import batch
    from tetractl.run.executors import on_this_machine
    from tetractl.statistics.open_batch import Batches
    from tetractl.study import arm_table, figure, missing_trials
    from tetractl.study.load_study import load_study
    from tetractl.view.terminal.progress import progress_of_script

    if folder is not None:
        demand(folder, str | Path, "a folder is a path")
    if logs not in ("all", "none"):
        raise UsageError(f"logs={logs!r}: must be 'all' or 'none'")
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
        tasks, _ = missing_trials.lacking(loaded, store, logs == "all", False)
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
    """Check that a spec can be simulated, log its warnings, and compile its kernels, as `warm_up`
    announces."""
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
    """Return the function that announces compiling: it prints to stderr if `progress` is True, and
    otherwise logs the message at level INFO."""
    if progress:
        return partial(print, file=sys.stderr, flush=True)
    return logging.getLogger("tetractl").info


@contextmanager
def _interruptible(after: str = "") -> "Iterator[Interrupt]":
    """Yield an `Interrupt` that counts signals such as Ctrl-C during the `with` block; after the
    block, KeyboardInterrupt if there were any, with `after`: what can be done then."""
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
    """A `RunObserver` that calls `on_result` for each trial, and shows the progress if wanted."""

    on_result: Callable[[int, Result], object]
    progress: "RunObserver | None" = None

    def trial_started(self, task: "Task") -> None:
        """Do nothing."""

    def trial_ended(self, ending: "Ending") -> None:
        """Show the progress; call `on_result` with the trial's number and result."""
        if self.progress:
            self.progress.trial_ended(ending)
        if ending.result:
            self.on_result(ending.task.trial, ending.result)


# ---- Reading ----


Trial = TrialLog | str | Path
"""A trial, or its log."""


def read_log(path: str | Path) -> TrialLog:
    """Read a trial from its log. If the log is damaged, the intact part is read and the trial's
    `damage` describes what is missing.

    Raises LogError if nothing can be read.
    """
    from tetractl.log.read.reader import read_trial

    demand(path, str | Path, "read_log reads the file of a log")
    return read_trial(Path(path))


def read_batch(*paths: str | Path) -> "Batch":
    """Read the results of trials, in about a millisecond per log; paths are logs, folders or
    patterns.

    The batch has `trials`, earlier `attempts` at them, and `damaged` logs. Raises UsageError for a
    path without a trial.
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
    """Return a batch that is read, given as a folder, or as the paths of its logs."""
    from tetractl.statistics.open_batch import Batch

    if isinstance(batch, Batch):
        return batch
    if isinstance(batch, str | Path):
        return read_batch(batch)
    demand(batch, Iterable, "a batch is a folder, paths of logs or what read_batch returns")
    return read_batch(*batch)


def _trials(data: "Trial | Sequence[Trial] | Batch") -> list[TrialLog]:
    """Return trials that are read, given as one, several, a batch or its folder."""
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
    """A trial of M camera frames, K control steps and N robots.

    Lengths are in `unit`, angles in radians; times count from the first direction sent. The last
    axis of poses is x, y, heading. `truth` is NaN if the true poses are not known, as in a lab.
    """

    unit: str
    robots: Strings  # (N,) names
    time_s: Floats = field(repr=False)  # (M,) when each frame was exposed
    frame: NDArray[np.int64] = field(repr=False)  # (M,) number of each frame
    poses: Floats = field(repr=False)  # (M, N, 3) as measured
    valid: Bools = field(repr=False)  # (M, N) whether the robot was tracked
    truth: Floats = field(repr=False)  # (M, N, 3)
    distance: Floats = field(repr=False)  # (M, N) from the measured position to the target
    step_time_s: Floats = field(repr=False)  # (K,) when each command was sent
    direction: Floats = field(repr=False)  # (K,) the common direction u, NaN while the field is off
    cost: Floats = field(repr=False)  # (K,) J of the chosen sequence, (7)
    length: NDArray[np.int64] = field(repr=False)  # (K,) number of signals in the chosen sequence
    evaluations: NDArray[np.int64] = field(repr=False)  # (K,) number of costs evaluated
    solve_ms: Floats = field(repr=False)  # (K,) wall time


def to_arrays(trial: Trial) -> TrialArrays:
    """Return poses, commands and decisions of a trial, or of its log, as arrays."""
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
    """Return a trial with one row for each frame and robot, or a batch with one row for each trial.

    These are the tables `poses` and `trials` of `tetractl export`. A trial's DataFrame names the
    plant, such as "emulated lab", in `attrs["origin"]`; a batch's names it in the column `origin`.
    Earlier attempts at a trial have `attempt` True. Raises UsageError if pandas is not installed.
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
    """Compute every decision in a log again, and check that the log's records agree with each
    other.
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
    """Return the statistics of a batch: errors with intervals, outcomes, the published result.

    `name` is the batch's name in tables and figures. Raises UsageError if the trials are not of one
    experiment.
    """
    from tetractl.statistics.describe import describe

    return describe(_batch(batch), name)


def compare(
    *batches: "BatchStatistics | Batch | str | Path | Sequence[str | Path]",
) -> "BatchComparison":
    """Compare the total errors of every two batches; differences are the first batch minus the
    second. Batches have the names of their folders, others those of `summarise`.
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
    """Draw a matplotlib figure, and write it to `file` (.png, .svg or .pdf) if given.

    `kind` names a figure of `tetractl plot`; "trajectory", "errors" and "batch" show several
    trials, those of a batch or its folder too. Statistics and comparisons are shown by "batch",
    whatever `kind` is. "video" is a video of one trial (.mp4, .gif or .webp).
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
    """Return the player of the report, of a trial, several trials, a batch or its folder; a
    notebook shows it.
    """
    from tetractl.report.page import player

    return player(_trials(data))


def play_page(spec: Spec, *, file: str | Path | None = None) -> "FramedPage":
    """Make a web page in which anybody steers the robots of a spec by hand.

    The page needs no server and no network. Its robots move by the spec's model, without
    disturbances. It carries one trial of the spec's controller, which this function simulates.

    Args:
        spec: The experiment: a loaded spec, a YAML file, or its contents.
        file: Where to write the page (.html). By default, it is not written.

    Returns:
        The page, which a notebook shows. Its HTML is the attribute `page`.

    Raises:
        SpecError: If the spec has a hold or way-points, which cannot be played.
        UsageError: If the robots are found by a camera, or move by a motion that the page does not
            know.

    Example:
        >>> tetractl.play_page("experiments/three_m3pi.yaml", file="play.html")
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
