"""Functions of the Python interface that simulate one trial.

The spec's controller steers the robots, or a script does so step by step.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tetractl.api.preparation import announcer, check_simulated, interruptible
from tetractl.api.specs import Spec, as_spec
from tetractl.core.errors import UsageError, require_type, require_whole_number
from tetractl.core.protocols import Observer
from tetractl.log.read.trial_log import TrialLog
from tetractl.spec.loaded_spec import LoadedSpec

if TYPE_CHECKING:
    from tetractl.run.open_trial import OpenTrial


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
        folder: Where to write the log. By default, nothing is written.
        observers: Observers that watch the trial while it runs.

    Returns:
        The trial, as `read_log` returns it. Without a folder, it has no `digest` and no `facts`
        about the computer, and its true poses and predicted paths are not rounded as in a log.

    Raises:
        SpecError: If the spec is wrong.
        UsageError: If the spec's plant is the lab, or if the log already exists.
        KeyboardInterrupt: After Ctrl-C has ended the trial.

    Example:
        >>> trial = tetractl.run_trial("experiments/single_cell.yaml")
        >>> trial.result.outcome.value
        'arrived'
    """
    spec = as_spec(spec)
    trial = require_whole_number(trial, "a trial")
    if folder is not None:
        require_type(folder, str | Path, "the folder must be a path")
    check_simulated(spec, announcer(True))
    if folder is None:
        return _simulate(spec, trial, observers)
    return _simulate_logged(spec, trial, observers, Path(folder))


def _simulate(spec: LoadedSpec, trial: int, observers: Sequence[Observer]) -> TrialLog:
    """Simulate a trial, and keep its records in memory instead of a log file."""
    from tetractl.log.recorder import TrialRecorder
    from tetractl.run.spec_trial import ready_trial

    recorder = TrialRecorder()
    with (
        interruptible() as interrupt,
        ready_trial(spec, trial, [recorder, *observers], interrupt) as ready,
    ):
        ready.run()
    return recorder.trial_log(f"{spec.name}, trial {trial}")


def _simulate_logged(
    spec: LoadedSpec, trial: int, observers: Sequence[Observer], folder: Path
) -> TrialLog:
    """Simulate a trial, write its log to `folder`, and read the log.

    The folder is made if it is missing. If it already holds the trial's log, a `UsageError` is
    raised.
    """
    from tetractl.log.read.reader import read_trial
    from tetractl.run.logged_trial import log_path, run_logged
    from tetractl.tools.files import make_folder

    path = log_path(folder, trial)
    if path.exists():
        raise UsageError(f"{path}: exists already", "name another folder")
    make_folder(folder)
    with interruptible() as interrupt:
        run_logged(spec, folder, trial, observers, interrupt)
        return read_trial(path)


def open_trial(spec: Spec, trial: int = 0, seed: int | None = None) -> "OpenTrial":
    """Open a simulated trial that your script steers, one control step at a time.

    Call `step` with a direction until `result` is no longer None. `observation` is the newest
    camera frame, and `save` writes a log like any other. The trial is the same as one in which the
    controller `sequence` sends the directions of the script.

    Args:
        spec: The experiment: a loaded spec, a YAML file, or its contents.
        trial: Index of the trial, from 0. It selects the random draws, together with the seed.
        seed: Seed to use instead of the spec's seed. None to use the spec's seed.

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
    """Load and check a spec for trials in which a script gives the directions.

    It raises the same errors as `open_trial`, for example a `UsageError` if the plant is the
    lab.
    """
    from tetractl.run.open_trial import directed_spec

    loaded = as_spec(spec)
    if loaded.experiment.plant.real_time:
        raise UsageError(
            "a script cannot drive robots in a lab, but the spec's plant is the lab",
            "use `tetractl run`",
        )
    opened = directed_spec(loaded)
    check_simulated(opened, announcer(True))
    return opened
