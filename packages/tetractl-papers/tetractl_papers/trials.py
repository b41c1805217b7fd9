"""Runs the trials of a paper's arms. A later call only runs the trials that are still missing."""

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
"""Function that runs the missing trials of a spec and logs them in a folder.

`tetractl.run_batch` with `resume` does the same.
"""


def run_arms(
    paper: Paper,
    folder: Path,
    specs: Mapping[str, Path],
    trials: int | None,
    run_batch: RunBatch,
    report_progress: Callable[[str], None],
) -> dict[str, Sequence[Any]]:
    """Run the trials of all arms of a paper, and return their results.

    Only the missing trials of an arm are run. An arm of type `Work` is always computed again.

    Args:
        paper: The paper.
        folder: Folder for the logs. Each arm has a folder in it.
        specs: Paths of the shipped specs, by name.
        trials: Number of trials of each arm. None for the number that the arm states.
        run_batch: Runs the missing trials of a batch.
        report_progress: Called with progress messages for the user.

    Returns:
        The results of each arm by its name: the logs of its trials, or the results of its `Work`.
    """
    results = dict[str, Sequence[Any]]()
    for name, arm in paper.arms.items():
        match arm:
            case Work():
                count = trials or arm.trials
                report_progress(f"{folder / name}: {count} times")
                results[name] = [arm.once(SEED, number) for number in range(count)]
            case Runs():
                count = trials or arm.trials
                report_progress(
                    f"{folder / name}: {count} trials of {arm.example} {' '.join(arm.sets)}"
                )
                results[name] = _run_arm(arm, results, folder / name, specs, count, run_batch)
    return results


def _run_arm(
    arm: Runs,
    results: Mapping[str, Sequence[TrialLog]],
    folder: Path,
    specs: Mapping[str, Path],
    count: int,
    run_batch: RunBatch,
) -> list[TrialLog]:
    """Run the missing trials of an arm, and return the logs of all its trials in order.

    Args:
        arm: The arm.
        results: Logs of the arms that were run before, by name. If this arm sends plans of another
            arm, that arm must be included.
        folder: Folder for the logs.
        specs: Paths of the shipped specs, by name.
        count: Number of trials.
        run_batch: Runs the missing trials of a batch.
    """
    spec = specs[arm.example]
    if arm.plans_of is not None:
        logs = list[TrialLog]()
        for number, plan_log in enumerate(results[arm.plans_of][:count]):
            settings = (*arm.sets, create_open_loop_setting(plan_log))
            logs += _run_trials(spec, settings, folder / f"plan-{number:03d}", 1, run_batch)
        return logs
    settings = arm.sets
    if arm.plan_of is not None:
        settings = (*settings, create_open_loop_setting(results[arm.plan_of][0]))
    return _run_trials(spec, settings, folder, count, run_batch)


def create_open_loop_setting(log: TrialLog) -> str:
    """Create the setting of a controller that repeats, in open loop, the plan of a trial's step 0.

    The setting has the form "controller={...}", as for `--set`.
    """
    directions = log.steps[0].plan.signals.tolist()
    period_s = log.experiment.controller.period
    return f"controller={{type: sequence, period: {period_s}, directions: {directions}}}"


def _run_trials(
    path: Path, sets: Sequence[str], folder: Path, count: int, run_batch: RunBatch
) -> list[TrialLog]:
    """Run the missing trials of a spec, and return the logs of all its trials in order.

    Args:
        path: The spec.
        sets: Settings that replace values of the spec. The root seed is always SEED.
        folder: Folder for the logs.
        count: Number of trials.
        run_batch: Runs the missing trials of a batch.
    """
    count_setting = FieldValue("trials.count", count, "--trials")
    seed_setting = FieldValue("trials.seed", SEED, "the seed of all papers")
    spec = load_spec(path, (*sets, count_setting, seed_setting))
    run_batch(spec, folder)
    return [read_trial(log_path(folder, trial)) for trial in range(count)]
