"""Run the trials of a study on an existing cluster of computers, with the library Dask."""

import logging
import queue
import tempfile
import time
from collections import deque
from collections.abc import Generator, Sequence
from concurrent.futures import CancelledError
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from tetractl.core.errors import AbortError, UsageError
from tetractl.run.executors import StartTask, TaskEnd
from tetractl.run.interrupt import Interrupt
from tetractl.run.logged_trial import log_path
from tetractl.run.task import FinishedTrial, Task, run_task
from tetractl.tools.files import write_atomically

TLS_PREFIX = "DASK_DISTRIBUTED__COMM__TLS"
"""Prefix of the environment variables that configure Dask's encryption."""
COUNT_INTERVAL_S = 1.0
"""Time between two counts of the cluster's workers, whose number may change [s]."""
TASK_DURATION_S = 2.0
"""Intended duration of a Dask task [s]. A scheduler handles some hundred tasks per second."""
MEAN_TRIAL_MIN_S = 1e-6
"""Minimum mean time of a trial by which the duration of a task is divided [s]."""
TASK_TRIALS_MAX = 200
"""Maximum number of trials in a Dask task. All logs of a task are returned together."""


class Cluster:
    """An executor that runs trials on a Dask cluster; a context manager.

    A Dask task holds a few seconds of trials, estimated from previous trials. If a worker is lost,
    the scheduler gives its task to another worker, at most three times. Then the trials are
    submitted one by one. Logs are returned with the results, so workers need no shared folder.

    Args:
        address: Address of the scheduler, such as tcp://host:8786.
        interrupt: Requests to end.

    Raises:
        UsageError: If no scheduler answers at `address` when the context is entered.
    """

    def __init__(self, address: str, interrupt: Interrupt) -> None:
        self._address = address
        self._interrupt = interrupt
        self._is_ended = False
        self._workers = 1
        self._next_count_s = 0.0

    def __enter__(self) -> Self:
        from distributed import Client
        from distributed.comm.addressing import get_address_host_port
        from distributed.security import Security

        # distributed logs the traceback of a lost connection, in whichever of its modules notices
        # the loss first; its configuration gives some of them a level of their own
        for module in ("distributed", "distributed.client", "distributed.gc"):
            logging.getLogger(module).setLevel(logging.CRITICAL)
        try:
            # without a port in the address, distributed would wait for ever
            get_address_host_port(self._address)
            security = Security()  # raises errors of Dask's configuration
            context = security.get_connection_args("client").get("ssl_context")
            if self._address.startswith("tls:") and context is None:
                raise UsageError(
                    f"{self._address}: the address needs TLS, but Dask is configured without "
                    "a certificate",
                    f"set the variables {TLS_PREFIX}__CA_FILE, {TLS_PREFIX}__CLIENT__CERT and "
                    f"{TLS_PREFIX}__CLIENT__KEY",
                )
            self._client: Client = Client(
                self._address,
                timeout=10.0,
                set_as_default=False,
                name="tetractl-study",
                security=security,
            )
        except (OSError, ValueError) as error:
            raise UsageError(
                f"{self._address}: no Dask scheduler answers at this address: {error}",
                "give an address such as tcp://host:8786, as `dask scheduler` prints it",
            ) from None
        return self

    def __exit__(self, *error: object) -> None:
        self._client.close()

    @property
    def workers(self) -> int:
        """The number of trials that run at the same time, at least 1.

        The number is updated every COUNT_INTERVAL_S.
        """
        now_s = time.monotonic()
        if now_s >= self._next_count_s and self._is_connected:
            with suppress(OSError):  # the connection is lost: `run` raises the error
                threads: Any = self._client.nthreads()
                self._workers = max(sum(threads.values()), 1)
            self._next_count_s = now_s + COUNT_INTERVAL_S
        return self._workers

    def run(self, tasks: Sequence[Task], start_task: StartTask) -> Generator[TaskEnd]:
        """Yield each task with its result or error, in the order in which the tasks end.

        Raises:
            AbortError: Once the scheduler is gone.
        """
        # `single_tasks` are tasks of lost Dask tasks, to be submitted one by one
        waiting = deque(tasks)
        single_tasks = deque[Task]()
        running = dict[Any, list[tuple[Task, Path]]]()
        done_futures: queue.SimpleQueue[Any] = queue.SimpleQueue()
        wall_s = 0.0
        finished_count = 0
        while not (self._is_ended or self._interrupt.requested):
            # two Dask tasks for each thread, so that none waits, and some without a worker
            window = max(2 * self.workers, 8)
            while (waiting or single_tasks) and len(running) < window:
                size = chunk_size(
                    wall_s / finished_count if finished_count else None, len(waiting), window
                )
                source, size = (single_tasks, 1) if single_tasks else (waiting, size)
                chunk = [source.popleft() for _ in range(size)]
                future = self._client.submit(_work, chunk, pure=False)
                running[future] = [(task, start_task(task)) for task in chunk]
                future.add_done_callback(done_futures.put)
            if not running:
                return
            try:
                # interval between two checks for an interruption [s]
                future = done_futures.get(timeout=0.1)
            except queue.Empty:
                if not self._is_connected:
                    raise self._lost_scheduler_error() from None
                continue
            submitted = running.pop(future)
            outcomes = self._collect_outcomes(submitted, future)
            if outcomes is None:
                single_tasks.extend(task for task, _ in submitted)
                continue
            for (task, _), outcome in zip(submitted, outcomes, strict=True):
                if isinstance(outcome, FinishedTrial):
                    wall_s += outcome.wall_s
                    finished_count += 1
                yield task, outcome
        if self._is_connected:
            self._client.cancel(list(running))

    def end(self) -> None:
        """Start no further trial, and do not wait for the running ones."""
        self._is_ended = True

    @property
    def _is_connected(self) -> bool:
        return self._client.status == "running"

    def _lost_scheduler_error(self) -> AbortError:
        return AbortError(
            f"{self._address}: the scheduler does not answer any more; all results so far "
            "are stored",
            "to continue, start a scheduler, and run the same command again with its address",
        )

    def _collect_outcomes(
        self, submitted: Sequence[tuple[Task, Path]], future: Any
    ) -> list[FinishedTrial | Exception] | None:
        """Store the logs of a finished Dask task, and return the result or error of each trial.

        The result is None if the task has several trials and every worker that ran it was lost.
        """
        from distributed import KilledWorker

        outcomes: list[tuple[FinishedTrial | Exception, bytes | None]] = []
        try:  # Dask cancels all tasks when the connection to the scheduler is lost
            error = future.exception()
            if error is None:
                outcomes = future.result()
        except (OSError, CancelledError):
            raise self._lost_scheduler_error() from None
        if isinstance(error, KilledWorker):
            if len(submitted) > 1:
                return None
            error = AbortError("the trial was lost, because every worker that ran it has stopped")
        if error is not None:
            return [error for _ in submitted]
        future.release()
        for (task, folder), (_, log) in zip(submitted, outcomes, strict=True):
            if log is not None:
                write_atomically(log_path(folder, task.trial), log)
        return [outcome for outcome, _ in outcomes]


def chunk_size(mean_trial_s: float | None, waiting: int, window: int) -> int:
    """Choose the number of trials in the next Dask task.

    Near the end of a study, the number falls, so that `window` tasks run until the end. The number
    is 1 as long as the mean time of a trial is unknown.

    Args:
        mean_trial_s: Mean wall time of a trial [s]. None if it is unknown.
        waiting: Number of trials that wait.
        window: Number of Dask tasks that are submitted at the same time.
    """
    if mean_trial_s is None:
        return 1
    affordable_count = int(TASK_DURATION_S / max(mean_trial_s, MEAN_TRIAL_MIN_S))
    return max(min(affordable_count, TASK_TRIALS_MAX, waiting // window), 1)


def _work(tasks: Sequence[Task]) -> list[tuple[FinishedTrial | Exception, bytes | None]]:
    """Run trials on a worker, and return the result or error of each one with its log."""
    return [_run(task) for task in tasks]


def _run(task: Task) -> tuple[FinishedTrial | Exception, bytes | None]:
    with tempfile.TemporaryDirectory(prefix="tetractl-") as name:
        try:
            outcome = run_task(task, Path(name), Interrupt())
        except Exception as error:  # returned with the trial's log, if there is one
            outcome = error
        path = log_path(Path(name), task.trial)
        return outcome, path.read_bytes() if path.exists() else None
