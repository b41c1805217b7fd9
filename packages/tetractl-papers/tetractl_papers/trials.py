"""Runs the arms of a paper. Each arm is a batch in a folder that a later call completes."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from tetractl.log.read.reader import read_trial
from tetractl.log.read.trial_log import TrialLog
from tetractl.run.logged_trial import log_path
from tetractl.spec.load import load_spec
from tetractl.spec.loaded_spec import LoadedSpec
from tetractl.spec.yaml.settings import FieldValue
from tetractl_papers.paper import Paper, Runs, Work

SEED = 20261128
"""The root seed of all trials."""

RunBatch = Callable[[LoadedSpec, Path], object]
"""Function that runs the trials of a spec that a folder lacks.

`tetractl.run_batch` with `resume` does the same.
"""


def run_arms(
    paper: Paper,
    folder: Path,
    specs: Mapping[str, Path],
    trials: int | None,
    run_batch: RunBatch,
    tell: Callable[[str], None],
) -> dict[str, Sequence[Any]]:
    """Run all arms of a paper, and return their results.

    Only the missing trials of an arm are run. An arm of type `Work` is always computed again.

    Args:
        paper: The paper.
        folder: Folder for the logs. Each arm has a folder in it.
        specs: Paths of the shipped specs, by name.
        trials: Number of trials of each arm. None for the arm's own number.
        run_batch: Runs the missing trials of a batch.
        tell: Called with progress messages for the user.

    Returns:
        For each arm's name, its trial logs, or the values that its `Work` has computed.
    """
    results = dict[str, Sequence[Any]]()
    for name, arm in paper.arms.items():
        match arm:
            case Work():
                count = trials or arm.trials
                tell(f"{folder / name}: {count} times")
                results[name] = [arm.once(SEED, number) for number in range(count)]
            case Runs():
                count = trials or arm.trials
                tell(f"{folder / name}: {count} trials of {arm.example} {' '.join(arm.sets)}")
                results[name] = _logs(arm, results, folder / name, specs, count, run_batch)
    return results


def _logs(
    arm: Runs,
    results: Mapping[str, Sequence[TrialLog]],
    folder: Path,
    specs: Mapping[str, Path],
    count: int,
    run_batch: RunBatch,
) -> list[TrialLog]:
    """Run the missing trials of an arm, and return the logs of all its trials in order.

    If the arm takes its plans from another arm, each of that arm's first `count` trials gives
    the plan of one trial. Then that arm's results must be in `results`.
    """
    spec = specs[arm.example]
    if arm.plans_of is not None:
        logs = list[TrialLog]()
        for number, planned in enumerate(results[arm.plans_of][:count]):
            settings = (*arm.sets, open_loop(planned))
            logs += _batch(spec, settings, folder / f"plan-{number:03d}", 1, run_batch)
        return logs
    settings = arm.sets
    if arm.plan_of is not None:
        settings = (*settings, open_loop(results[arm.plan_of][0]))
    return _batch(spec, settings, folder, count, run_batch)


def open_loop(log: TrialLog) -> str:
    """Return the spec setting of a controller that sends the plan of a trial's step 0, open loop.

    It has the form "controller={...}", as for `--set`.
    """
    directions = log.steps[0].plan.signals.tolist()
    period_s = log.experiment.controller.period
    return f"controller={{type: sequence, period: {period_s}, directions: {directions}}}"


def _batch(
    path: Path, sets: Sequence[str], folder: Path, count: int, run_batch: RunBatch
) -> list[TrialLog]:
    """Run the missing trials of a spec with settings, and return the logs of all its trials.

    `folder` keeps the logs. The seed is SEED, and the logs come in the order of the trials.
    """
    trials = FieldValue("trials.count", count, "--trials")
    seed = FieldValue("trials.seed", SEED, "the seed of all papers")
    spec = load_spec(path, (*sets, trials, seed))
    run_batch(spec, folder)
    return [read_trial(log_path(folder, trial)) for trial in range(count)]
