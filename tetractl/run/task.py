"""A task: one trial in a form that any process can run.

A study or a batch creates tasks. Its executor runs them in this process, in other processes or on a
cluster. A task is pickled with its spec to be sent there.
"""

import gc
import pickle
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from tetractl.control.methods.build import warm_up
from tetractl.core.errors import TetractlError, UsageError
from tetractl.core.protocols import LabSupervision, Observer
from tetractl.core.trial import Result
from tetractl.log.provenance import trial_code
from tetractl.run.interrupt import Interrupt
from tetractl.run.logged_trial import run_logged
from tetractl.spec.experiment import Experiment, find_packages
from tetractl.spec.loaded_spec import LoadedSpec

SPECS_CACHED_MAX = 64
"""Maximum number of specs that a process keeps loaded; the latest ones are kept."""


@dataclass(frozen=True, slots=True)
class Task:
    """One trial to run, in a form that can be sent to another process.

    Attributes:
        trial: Index of the trial, from 0.
        trial_count: Number of trials in the batch or arm.
        spec: The pickled LoadedSpec.
        arm: Name of the arm in a study. Empty otherwise.
        code_hash: Hash of the code with which the trial must be run, from the function `code_hash`.
            Empty if any code may run the trial.
    """

    trial: int
    trial_count: int
    spec: bytes
    arm: str = ""
    code_hash: str = ""

    @property
    def key(self) -> tuple[str, int]:
        """Name of the arm and index of the trial, which identify the task in a run."""
        return self.arm, self.trial


@dataclass(frozen=True, slots=True)
class FinishedTrial:
    """The result of a finished trial, and its wall time.

    Attributes:
        result: The result.
        wall_s: Wall time from creating the plant to the end of the log [s].
    """

    result: Result
    wall_s: float


class OtherCodeError(UsageError):
    """An error: the code on a worker differs from the code on the computer that runs the study.

    The trials of this worker could therefore differ.
    """


def batch_tasks(spec: LoadedSpec, trials: Sequence[int]) -> list[Task]:
    """Create the tasks of a batch: one for each of the given trial indices of a spec."""
    pickled = pickle.dumps(spec)
    return [Task(trial, spec.experiment.trials.count, pickled) for trial in trials]


def code_hash(experiment: Experiment) -> str:
    """Compute the hash of the code that runs the trials of an experiment on this machine."""
    by_name = sorted(find_packages(experiment).items())
    return trial_code(tuple(by_name))


def run_task(
    task: Task,
    folder: Path,
    interrupt: Interrupt,
    observers: Sequence[Observer] = (),
    supervision: LabSupervision | None = None,
) -> FinishedTrial:
    """Run the trial that a task describes, and write its log.

    Args:
        task: The trial.
        folder: Where to write the log.
        interrupt: Requests to end the trial.
        observers: Observers that watch the trial.
        supervision: How people supervise the run. Only real robots need it.

    Raises:
        OtherCodeError: If the code of this process differs from the task's `code_hash`.
        Exception: Any error that leaves the trial without an outcome, such as a camera that does
            not answer.
    """
    spec = _load_spec(task.spec, task.code_hash)
    began_s = time.perf_counter()
    result = run_logged(spec, folder, task.trial, observers, interrupt, supervision)
    return FinishedTrial(result, time.perf_counter() - began_s)


@lru_cache(maxsize=SPECS_CACHED_MAX)
def _load_spec(spec: bytes, expected_code_hash: str) -> LoadedSpec:
    """Load a task's spec, and compile the code that its trials need, once in each process."""
    loaded: LoadedSpec = pickle.loads(spec)
    if expected_code_hash and code_hash(loaded.experiment) != expected_code_hash:
        raise OtherCodeError(
            "the code of tetractl on the worker differs from the code on the computer that "
            "runs the study",
            "install the same tetractl, numpy, numba, llvmlite, scipy and plug-ins on the worker",
        )
    with suppress(TetractlError):  # the trial raises the same error
        warm_up(loaded.experiment, lambda text: None)
    # what is loaded and compiled for a spec stays in memory: if each garbage collection searched
    # it, control steps would be late
    gc.freeze()
    return loaded
