"""Functions of the Python interface that simulate one trial.

The spec's controller steers the robots, or a script does so step by step.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from tetractl.api.preparation import announcer, check_simulated, interruptible
from tetractl.api.specs import Spec, as_spec
from tetractl.core.errors import UsageError, demand, whole_number
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
    from tetractl.tools.files import make_folder

    spec = as_spec(spec)
    trial = whole_number(trial, "a trial")
    if folder is not None:
        demand(folder, str | Path, "a folder is a path")
    check_simulated(spec, announcer(True))
    with TemporaryDirectory() as temporary, interruptible() as interrupt:
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
    camera frame, and `save` writes a log like any other. The trial is the same as one in which the
    controller `sequence` sends the directions of the script.

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
    """Check and compile a spec for trials that a script steers.

    It raises the same errors as `open_trial`.
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
