"""Run the trials of a study on an existing cluster of computers, by the library Dask."""

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
from tetractl.run.task import Finished, Task, run_task
from tetractl.tools.files import save_whole

TLS = "DASK_DISTRIBUTED__COMM__TLS"  # prefix of Dask's environment variables
COUNT_S = 1.0  # interval between two counts of the workers, whose number may change [s]
TASK_S = 2.0  # duration of a Dask task [s]; a scheduler handles some hundred tasks per second
LEAST_S = 1e-6  # least mean time of a trial by which the duration is divided [s]
TASK_TRIALS_MAX = 200  # largest number of trials in a Dask task, whose logs are returned together


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
        self._ended = False
        self._workers = 1
        self._count_at_s = 0.0

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
                    f"set the variables {TLS}__CA_FILE, {TLS}__CLIENT__CERT and {TLS}__CLIENT__KEY",
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
        """Number of trials that run at the same time, at least 1. It is updated every COUNT_S."""
        now = time.monotonic()
        if now >= self._count_at_s and self._connected:
            with suppress(OSError):  # the connection is lost: `run` raises the error
                threads: Any = self._client.nthreads()
                self._workers = max(sum(threads.values()), 1)
            self._count_at_s = now + COUNT_S
        return self._workers

    def run(self, tasks: Sequence[Task], start_task: StartTask) -> Generator[TaskEnd]:
        """Yield each task with its result or error, in the order in which the tasks end.

        Raises:
            AbortError: Once the scheduler is gone.
        """
        # `alone` are tasks of lost Dask tasks, to be submitted one by one
        waiting = deque(tasks)
        alone = deque[Task]()
        running = dict[Any, list[tuple[Task, Path]]]()
        ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        wall_s = 0.0
        count = 0
        while not (self._ended or self._interrupt.requested):
            # two Dask tasks for each thread, so that none waits, and some without a worker
            window = max(2 * self.workers, 8)
            while (waiting or alone) and len(running) < window:
                size = chunk_size(wall_s / count if count else None, len(waiting), window)
                source, size = (alone, 1) if alone else (waiting, size)
                chunk = [source.popleft() for _ in range(size)]
                future = self._client.submit(_work, chunk, pure=False)
                running[future] = [(task, start_task(task)) for task in chunk]
                future.add_done_callback(ended.put)
            if not running:
                return
            try:
                # interval between two checks for an interruption [s]
                future = ended.get(timeout=0.1)
            except queue.Empty:
                if not self._connected:
                    raise self._gone() from None
                continue
            submitted = running.pop(future)
            outcomes = self._found(submitted, future)
            if outcomes is None:
                alone.extend(task for task, _ in submitted)
                continue
            for (task, _), outcome in zip(submitted, outcomes, strict=True):
                if isinstance(outcome, Finished):
                    wall_s += outcome.wall_s
                    count += 1
                yield task, outcome
        if self._connected:
            self._client.cancel(list(running))

    def end(self) -> None:
        """Start no further trial, and do not wait for the running ones."""
        self._ended = True

    @property
    def _connected(self) -> bool:
        return self._client.status == "running"

    def _gone(self) -> AbortError:
        return AbortError(
            f"{self._address}: the scheduler does not answer any more; all results so far "
            "are stored",
            "to continue, start a scheduler, and run the same command again with its address",
        )

    def _found(
        self, submitted: Sequence[tuple[Task, Path]], future: Any
    ) -> list[Finished | Exception] | None:
        """Store the logs that a Dask task returned, and return each trial's result or error.

        The result is None if the task has several trials and every worker that ran it was lost.
        """
        from distributed import KilledWorker

        outcomes: list[tuple[Finished | Exception, bytes | None]] = []
        try:  # Dask cancels all tasks when the connection to the scheduler is lost
            error = future.exception()
            if error is None:
                outcomes = future.result()
        except (OSError, CancelledError):
            raise self._gone() from None
        if isinstance(error, KilledWorker):
            if len(submitted) > 1:
                return None
            error = AbortError("the trial was lost, because every worker that ran it has stopped")
        if error is not None:
            return [error for _ in submitted]
        future.release()
        for (task, folder), (_, log) in zip(submitted, outcomes, strict=True):
            if log is not None:
                save_whole(log_path(folder, task.trial), log)
        return [outcome for outcome, _ in outcomes]


def chunk_size(mean_s: float | None, waiting: int, window: int) -> int:
    """Choose the number of trials in a Dask task.

    Near the end, the number falls, so that `window` tasks run until the end. As long as the mean
    time is unknown, it is 1.

    Args:
        mean_s: Mean time of a trial [s]. None if unknown.
        waiting: Number of trials that wait.
        window: Number of Dask tasks that are submitted at the same time.
    """
    if mean_s is None:
        return 1
    in_time = int(TASK_S / max(mean_s, LEAST_S))
    return max(min(in_time, TASK_TRIALS_MAX, waiting // window), 1)


def _work(tasks: Sequence[Task]) -> list[tuple[Finished | Exception, bytes | None]]:
    """Run trials on a worker, and return the result or error of each one with its log."""
    return [_run(task) for task in tasks]


def _run(task: Task) -> tuple[Finished | Exception, bytes | None]:
    with tempfile.TemporaryDirectory(prefix="tetractl-") as name:
        try:
            outcome = run_task(task, Path(name), Interrupt())
        except Exception as error:  # returned with the trial's log, if there is one
            outcome = error
        path = log_path(Path(name), task.trial)
        return outcome, path.read_bytes() if path.exists() else None
