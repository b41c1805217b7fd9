"""Executors that run trials on this machine: in this process, or in worker processes.

There are two kinds of `Executor`. `Here` runs tasks one after another in this process, `Processes`
runs several at the same time. Their method `run` yields every task that was started, with its
result or error. It returns early after `end`, or after the first request of the interrupt. `called`
does the same for plain calls.

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
from tetractl.run.task import Finished, Task, run_task
from tetractl.tools.worker_pool import WorkerPool, copying_context, fresh_context, isolated

KILLED = "a trial's process was killed twice, perhaps because memory ran out"
PRINTED = "printed in a trial's process"
CHECK_S = 0.1
"""Time between two checks for a request to stop while trials run [s]."""
SIGTERM_S = 1.0
"""Time between two SIGTERMs to a worker [s].

They are repeated, because an exception that is raised in a finaliser is lost.
"""
CLOSE_LOG_S = 5.0
"""Time for a worker to close its log after its parent process has ended [s]."""
T = TypeVar("T")
R = TypeVar("R")

TaskEnd = tuple[Task, Finished | Exception]
"""A task, and its result or error."""

StartTask = Callable[[Task], Path]
"""A function that is called in this process before a task starts.

It returns the folder for the log.
"""


class Executor(Protocol):
    """An object that runs trials somewhere: `Here`, `Processes` or `cluster.Cluster`."""

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
        """Start no further trial, and end the running ones early."""
        ...


def on_this_machine(jobs: int, tasks: int, interrupt: Interrupt) -> Executor:
    """Choose the executor for a number of trials on this machine.

    Args:
        jobs: How many trials to run at the same time, each in its own process if there are several.
        tasks: Number of tasks. No more processes than tasks are used.
        interrupt: Requests to end.
    """
    jobs = min(jobs, tasks)
    return Processes(jobs, interrupt) if jobs > 1 else Here(interrupt)


class Here:
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
        self._ended = False

    def run(self, tasks: Sequence[Task], start_task: StartTask) -> Generator[TaskEnd]:
        """Run the tasks one after another, and yield each with its result or error.

        No further task starts once a stop was requested.
        """
        for task in tasks:
            if self._ended or self._interrupt.requested:
                return
            folder = start_task(task)
            try:
                ended = run_task(task, folder, self._interrupt, self._observers, self._supervision)
            except TetractlError as error:
                # without the traceback, as from a process: it would keep the whole plant in memory
                error.__cause__ = error.__context__ = None
                ended = error.with_traceback(None)
            except Exception as error:
                ended = error
            yield task, ended

    def end(self) -> None:
        """Start no further trial. A trial that already runs goes on."""
        self._ended = True


class Processes:
    """An executor that runs several trials at the same time, each in its own process.

    The first request of `interrupt` ends the running trials after their control step, the second
    ends them at once. If a process is killed, the trials that were running are repeated one by one.
    A trial fails if its process is killed again.
    """

    def __init__(self, workers: int, interrupt: Interrupt) -> None:
        self.workers = workers
        self._interrupt = interrupt
        self._context = fresh_context(["tetractl.run.preloaded"])
        # Python starts its semaphore tracker in the block
        with _signals_held_back(), isolated():
            self._ending = self._context.Event()
        self._next_sigterm_s = 0.0
        """Earliest time of the next SIGTERM to the workers, on the monotonic clock [s]."""

    def run(self, tasks: Sequence[Task], start_task: StartTask) -> Generator[TaskEnd]:
        """Run the tasks in worker processes. Yield each with its result or error as it ends."""
        waiting = deque(tasks)
        while waiting and not self._ending.is_set():
            suspects = list[Task]()
            for task, ended in self._in_pool(waiting, self.workers, start_task):
                if isinstance(ended, BrokenProcessPool):
                    suspects.append(task)
                else:
                    yield task, ended
            for suspect in suspects:
                yield from self._repeat(suspect, start_task)

    def end(self) -> None:
        """Start no further trial, and end the running ones early."""
        self._ending.set()

    def _repeat(self, suspect: Task, start_task: StartTask) -> Iterator[TaskEnd]:
        """Run a task again, alone, that was running when a worker was killed.

        If its worker is also killed, the task fails.
        """
        for task, ended in self._in_pool(deque([suspect]), 1, start_task):
            if isinstance(ended, BrokenProcessPool):
                hint = "to continue, run the same command again with fewer --jobs"
                in_python = "to continue, call the function again with fewer jobs"
                yield task, AbortError(KILLED, hint, in_python)
            else:
                yield task, ended

    def _in_pool(
        self, waiting: "deque[Task]", workers: int, start_task: StartTask
    ) -> Iterator[TaskEnd]:
        """Run the waiting tasks until a worker is killed.

        Running tasks then end with the error BrokenProcessPool, and the others stay in `waiting`.
        """
        running = dict[Future[Finished], Task]()
        broken = False
        environment = dict(os.environ)
        with WorkerPool(
            self._context, workers, PRINTED, _print_line, _start_worker, (self._ending, environment)
        ) as pool:
            while True:
                if self._interrupt.requested:
                    self._ending.set()
                ends = broken or self._ending.is_set()
                while waiting and len(running) < workers and not ends:
                    task = waiting.popleft()
                    folder = start_task(task)
                    with _signals_held_back():  # `submit` starts workers
                        running[pool.submit(_work, task, folder)] = task
                    ends = self._ending.is_set()
                if not running:
                    return
                done, _ = wait(running, timeout=CHECK_S, return_when=FIRST_COMPLETED)
                for future in done:
                    error = future.exception()
                    if error is not None and not isinstance(error, Exception):
                        raise error
                    if isinstance(error, BrokenProcessPool):
                        broken = True
                    yield running.pop(future), error or future.result()
                self._stop_at_once()

    def _stop_at_once(self) -> None:
        """Send SIGTERM to the workers after a second request to stop, again and again."""
        if self._interrupt.count < 2 or time.monotonic() < self._next_sigterm_s:
            return
        self._ending.set()  # else workers take SIGTERM for that of a broken pool
        for worker in multiprocessing.active_children():
            worker.terminate()
        self._next_sigterm_s = time.monotonic() + SIGTERM_S


def _print_line(line: str) -> None:
    """Print a line that a worker process has printed, to stderr."""
    with suppress(OSError, ValueError):  # stderr may be closed
        print(line, file=sys.stderr, flush=True)


def called(
    call: Callable[[T], R], items: Sequence[T], jobs: int, tell: Callable[[str], object]
) -> Iterator[R]:
    """Call a function for each item in worker processes, and yield the results as they finish.

    Args:
        call: The function.
        items: Its arguments.
        jobs: How many calls to run at the same time.
        tell: Called with each line that the workers print.
    """
    jobs = min(jobs, len(items))
    if jobs < 2:
        yield from map(call, items)
        return
    with WorkerPool(copying_context(), jobs, PRINTED, tell) as pool:
        for ended in as_completed([pool.submit(call, item) for item in items]):
            yield ended.result()


def _work(task: Task, folder: Path) -> Finished:
    return run_task(task, folder, _interrupt)


@contextmanager
def _signals_held_back() -> Iterator[None]:
    """Block signals in worker processes that are started in the `with` block.

    They stay blocked until these processes call `_start_worker`.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, STOP_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _SharedInterrupt(Interrupt):
    """A worker's interrupt: the shared event is the first request, SIGTERM the second."""

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
        self._break()


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
    time.sleep(CLOSE_LOG_S)
    os._exit(1)
