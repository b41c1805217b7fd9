"""Executors that run trials on this machine: in this process, or in worker processes.

There are two kinds of `Executor`. An `InProcessExecutor` runs tasks one after another in this
process. A `ProcessExecutor` runs several tasks at the same time. Their method `run` yields every
task that was started, with its result or error. It returns early after `end`, or after the first
request of the interrupt. `call_in_workers` calls a plain function in worker processes.

A worker process ends in one of four ways:

1. Its pool ends, and the worker with it.
2. The event `ending` is its interrupt's first request: the trial ends after its control step.
3. SIGTERM is the second request: the trial ends at once. Before a request, SIGTERM ends the worker.
4. If its parent ends, the worker sends SIGTERM to itself, and ends soon after.

Signals of a terminal also reach the workers, which ignore them: only the parent reacts.
"""

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, as_completed, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Protocol, TypeVar

from tetractl.core.errors import AbortError, TetractlError
from tetractl.core.protocols import LabSupervision, Observer
from tetractl.run.interrupt import STOP_SIGNALS, Interrupt
from tetractl.run.task import FinishedTrial, Task, run_task
from tetractl.tools.worker_pool import (
    WorkerPool,
    create_clean_context,
    create_fork_context,
    exclude_current_folder,
)

KILLED_TEXT = "a trial's process was killed twice, perhaps because memory ran out"
PRINTED_TEXT = "printed in a trial's process"
CHECK_INTERVAL_S = 0.1
"""Time between two checks for a request to stop while trials run [s]."""
SIGTERM_INTERVAL_S = 1.0
"""Time between two SIGTERMs to a worker [s].

They are repeated, because an exception that is raised in a finaliser is lost.
"""
CLOSE_LOG_TIMEOUT_S = 5.0
"""Time for a worker to close its log after its parent process has ended [s]."""
T = TypeVar("T")
R = TypeVar("R")

TaskEnd = tuple[Task, FinishedTrial | Exception]
"""A task that has ended, with its result or its error."""

StartTask = Callable[[Task], Path]
"""A function that is called in this process before a task starts.

It returns the folder for the log of the trial.
"""


class Executor(Protocol):
    """An object that runs trials: in this process, in worker processes, or on a cluster."""

    @property
    def workers(self) -> int:
        """The number of trials that run at the same time."""
        ...

    def run(self, tasks: Sequence[Task], start_task: StartTask) -> Generator[TaskEnd]:
        """Run tasks, and yield each task that was started with its result or error.

        Tasks are yielded as they end. No further task is started after `end`, or once the
        interrupt is requested.

        Args:
            tasks: The tasks, in the order in which they are started.
            start_task: Called in this process before a task starts; returns the folder for its
                log.
        """
        ...

    def end(self) -> None:
        """Start no further trial, and end the running trials early."""
        ...


def local_executor(jobs: int, task_count: int, interrupt: Interrupt) -> Executor:
    """Choose the executor for a number of trials on this machine.

    Args:
        jobs: How many trials to run at the same time, each in its own process if there are several.
        task_count: Number of tasks. No more processes than tasks are used.
        interrupt: Requests to end.
    """
    jobs = min(jobs, task_count)
    return ProcessExecutor(jobs, interrupt) if jobs > 1 else InProcessExecutor(interrupt)


class InProcessExecutor:
    """An executor that runs one trial after another in this process.

    Args:
        interrupt: Requests to end.
        observers: Notified of every trial.
        supervision: How people supervise trials in a lab. None if nobody does.
    """

    workers = 1

    def __init__(
        self,
        interrupt: Interrupt,
        observers: Sequence[Observer] = (),
        supervision: LabSupervision | None = None,
    ) -> None:
        self._interrupt = interrupt
        self._observers = observers
        self._supervision = supervision
        self._is_ended = False

    def run(self, tasks: Sequence[Task], start_task: StartTask) -> Generator[TaskEnd]:
        """Run the tasks one after another, and yield each with its result or error.

        No further task starts once a stop was requested.
        """
        for task in tasks:
            if self._is_ended or self._interrupt.requested:
                return
            folder = start_task(task)
            try:
                outcome = run_task(
                    task, folder, self._interrupt, self._observers, self._supervision
                )
            except TetractlError as error:
                # without the traceback, as from a process: it would keep the whole plant in memory
                error.__cause__ = error.__context__ = None
                outcome = error.with_traceback(None)
            except Exception as error:
                outcome = error
            yield task, outcome

    def end(self) -> None:
        """Start no further trial. A trial that already runs goes on."""
        self._is_ended = True


class ProcessExecutor:
    """An executor that runs several trials at the same time, each in its own process.

    The first request of `interrupt` ends the running trials after their control step, the second
    ends them at once. If a process is killed, the trials that were running are repeated one by one.
    A trial fails if its process is killed again.
    """

    def __init__(self, workers: int, interrupt: Interrupt) -> None:
        self.workers = workers
        self._interrupt = interrupt
        self._context = create_clean_context(["tetractl.run.preloaded"])
        # Python starts its semaphore tracker in the block
        with _block_signals(), exclude_current_folder():
            self._ending = self._context.Event()
        self._next_sigterm_s = 0.0
        """Earliest time of the next SIGTERM to the workers, on the monotonic clock [s]."""

    def run(self, tasks: Sequence[Task], start_task: StartTask) -> Generator[TaskEnd]:
        """Run the tasks in worker processes. Yield each with its result or error as it ends.

        This process calls `start_task` before a worker starts a task. If a worker was killed, its
        task runs once more, without others at the same time.
        """
        waiting = deque(tasks)
        while waiting and not self._ending.is_set():
            suspects = list[Task]()
            for task, outcome in self._run_in_pool(waiting, self.workers, start_task):
                if isinstance(outcome, BrokenProcessPool):
                    suspects.append(task)
                else:
                    yield task, outcome
            for suspect in suspects:
                yield from self._repeat_alone(suspect, start_task)

    def end(self) -> None:
        """Start no further trial, and end the running ones early."""
        self._ending.set()

    def _repeat_alone(self, suspect: Task, start_task: StartTask) -> Iterator[TaskEnd]:
        """Run a task again, without others at the same time, after a worker was killed.

        The task was running when the worker was killed. If its own worker is now killed, the task
        fails.
        """
        for task, outcome in self._run_in_pool(deque([suspect]), 1, start_task):
            if isinstance(outcome, BrokenProcessPool):
                hint = "to continue, run the same command again with fewer --jobs"
                in_python = "to continue, call the function again with fewer jobs"
                yield task, AbortError(KILLED_TEXT, hint, in_python)
            else:
                yield task, outcome

    def _run_in_pool(
        self, waiting: "deque[Task]", workers: int, start_task: StartTask
    ) -> Iterator[TaskEnd]:
        """Run the waiting tasks in a pool of workers, until a worker is killed.

        Running tasks then end with the error BrokenProcessPool. Tasks that were not started stay in
        `waiting`.
        """
        running = dict[Future[FinishedTrial], Task]()
        is_broken = False
        environment = dict(os.environ)
        with WorkerPool(
            self._context,
            workers,
            PRINTED_TEXT,
            _print_line,
            _start_worker,
            (self._ending, environment),
        ) as pool:
            while True:
                if self._interrupt.requested:
                    self._ending.set()
                is_ending = is_broken or self._ending.is_set()
                while waiting and len(running) < workers and not is_ending:
                    task = waiting.popleft()
                    folder = start_task(task)
                    with _block_signals():  # `submit` starts workers
                        running[pool.submit(_work, task, folder)] = task
                    is_ending = self._ending.is_set()
                if not running:
                    return
                done_futures, _ = wait(
                    running, timeout=CHECK_INTERVAL_S, return_when=FIRST_COMPLETED
                )
                for future in done_futures:
                    error = future.exception()
                    if error is not None and not isinstance(error, Exception):
                        raise error
                    if isinstance(error, BrokenProcessPool):
                        is_broken = True
                    yield running.pop(future), error or future.result()
                self._stop_at_once()

    def _stop_at_once(self) -> None:
        """After a second request to stop, send SIGTERM to the workers every SIGTERM_INTERVAL_S."""
        if self._interrupt.count < 2 or time.monotonic() < self._next_sigterm_s:
            return
        self._ending.set()  # otherwise workers would take SIGTERM for the end of a broken pool
        for worker in multiprocessing.active_children():
            worker.terminate()
        self._next_sigterm_s = time.monotonic() + SIGTERM_INTERVAL_S


def _print_line(line: str) -> None:
    """Print a line that a worker process has printed, to stderr."""
    with suppress(OSError, ValueError):  # stderr may be closed
        print(line, file=sys.stderr, flush=True)


def call_in_workers(
    call: Callable[[T], R], items: Sequence[T], jobs: int, print_line: Callable[[str], object]
) -> Iterator[R]:
    """Call a function for each item in worker processes, and yield each result when it is ready.

    Args:
        call: The function, which takes one item.
        items: The items. With fewer than two jobs, the calls are made in this process.
        jobs: Maximum number of calls that run at the same time.
        print_line: Called with each line that the workers print.
    """
    jobs = min(jobs, len(items))
    if jobs < 2:
        yield from map(call, items)
        return
    with WorkerPool(create_fork_context(), jobs, PRINTED_TEXT, print_line) as pool:
        for future in as_completed([pool.submit(call, item) for item in items]):
            yield future.result()


def _work(task: Task, folder: Path) -> FinishedTrial:
    return run_task(task, folder, _interrupt)


@contextmanager
def _block_signals() -> Iterator[None]:
    """Block signals in the worker processes that are started in the `with` block.

    The signals stay blocked until these processes call `_start_worker`.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    previous_mask = signal.pthread_sigmask(signal.SIG_BLOCK, STOP_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, previous_mask)


class _SharedInterrupt(Interrupt):
    """The interrupt of a worker process.

    The event that all workers share is the first request, and SIGTERM is the second.
    """

    def __init__(self, ending: Event) -> None:
        super().__init__()
        self.ending = ending

    @property
    def requested(self) -> bool:
        return self.count > 0 or self.ending.is_set()

    def end_at_once(self) -> None:
        """Count SIGTERM as the second request.

        Without a first request, SIGTERM means that the pool's server was killed. The trial will be
        repeated, so this process ends without writing its log.
        """
        if not self.ending.is_set():
            os._exit(1)
        self.count = 2
        self._raise_if_due()


_interrupt: Interrupt = Interrupt()  # the interrupt of this process, if it is a worker


def _start_worker(ending: Event, environment: dict[str, str]) -> None:
    """Prepare a worker. It ignores all signals except SIGTERM, and ends when its parent ends.

    Its environment variables are set to those that its parent has now. When the server was started,
    they may have been different.
    """
    global _interrupt
    os.environ.update(environment)
    interrupt = _SharedInterrupt(ending)
    _interrupt = interrupt
    for number in STOP_SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda number, frame: interrupt.end_at_once())
    sys.unraisablehook = interrupt.on_unraisable
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, STOP_SIGNALS)  # delivers the blocked signals
    threading.Thread(target=_end_with_parent, args=(ending,), name="parent", daemon=True).start()


def _end_with_parent(ending: Event) -> None:
    """Wait for the parent process to end. Then end the trial and, shortly after, this process."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    ending.set()
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(CLOSE_LOG_TIMEOUT_S)
    os._exit(1)
