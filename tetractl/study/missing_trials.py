"""Find the trials of a study that still have to be run."""

import pickle
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from tetractl.control.methods.build import warm_up
from tetractl.core.errors import TetractlError
from tetractl.run.store import Store
from tetractl.run.task import Task
from tetractl.study.load_study import LoadedStudy
from tetractl.tools.table.table import Table


def unfinished_tasks(
    loaded: LoadedStudy, store: Store, rerun_outdated: bool
) -> tuple[list[Task], dict[str, int]]:
    """Create the tasks for the unfinished trials of a study.

    A trial is outdated if another version of the code has run it. Tasks are ordered by trial
    number, so that all arms have about equally many trials if the run ends early.

    Args:
        loaded: The study.
        store: The folder of the study.
        rerun_outdated: Whether to run outdated trials again.

    Returns:
        The tasks, and the number of outdated trials that are kept in each arm.
    """
    trial_count = loaded.study.trials.count
    tasks: list[Task] = []
    outdated: dict[str, int] = {}
    for arm in loaded.arms:
        spec = pickle.dumps(arm.spec)
        batch = store.batches[arm.name]
        trials = list(batch.unfinished)
        if rerun_outdated:
            trials += batch.outdated
        elif batch.outdated:
            outdated[arm.name] = len(batch.outdated)
        tasks += [
            Task(number, trial_count, spec, arm.name, arm.code_hash) for number in sorted(trials)
        ]
    return sorted(tasks, key=lambda task: task.trial), outdated


def warm_up_arms(loaded: LoadedStudy, announce: Callable[[str], None]) -> None:
    """Compile the code that a study needs, with the spec of one arm per controller.

    An arm that fails here is passed over, because its trials report the failure.
    """
    for arm in {arm.controller: arm for arm in loaded.arms}.values():
        with suppress(TetractlError):
            warm_up(arm.spec.experiment, announce)


def dry_run(loaded: LoadedStudy, folder: Path, tasks: Sequence[Task]) -> Table:
    """Create a table of the arms: their differences from the base, and how many trials to run.

    Args:
        loaded: The study.
        folder: The folder of the study.
        tasks: The trials to run.
    """
    to_run = Counter(task.arm for task in tasks)
    rows = [(arm.name, ", ".join(arm.sets), str(to_run[arm.name])) for arm in loaded.arms]
    count = len(loaded.arms) * loaded.study.trials.count
    title = f"{loaded.study.name}: a run would add {len(tasks)} of {count} trials to {folder}"
    return Table.of_texts(title, ("arm", "differs from the base in", "trials to run"), rows)
