"""Worker processes for trials: tasks in parallel, stopped by the parent alone, outliving nobody."""

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.synchronize import Event
from types import TracebackType
from typing import Self, TypeVar

from tetractl.run.interrupt import SIGNALS, Interrupt

SIGNAL_AGAIN_S = 1.0
ORPHAN_S = 5.0  # a worker without a parent closes its log within that

T = TypeVar("T")
R = TypeVar("R")


class Pool:
    """`jobs` processes that run tasks; a context manager.

    The first request of `interrupt` lets the tasks that run end early, by the interrupt of their
    process; the second ends them at once.
    """

    def __init__(self, jobs: int, interrupt: Interrupt) -> None:
        self._jobs, self._interrupt = jobs, interrupt
        self._again = 0.0  # when SIGTERM may be sent to the workers once more

    def __enter__(self) -> Self:
        context = multiprocessing.get_context("spawn")  # a fork would copy threads half-way
        with _signals_held_back():  # the process that looks after semaphores starts here
            self._ending = context.Event()
        self._pool = ProcessPoolExecutor(self._jobs, context, _start_worker, (self._ending,))
        self._pool.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._pool.__exit__(kind, error, trace)

    def end(self) -> None:
        """Start no further task, and let those that run end early."""
        self._ending.set()

    def run(
        self,
        work: Callable[[T], R],
        tasks: Iterable[T],
        started: Callable[[T], object] = lambda task: None,
    ) -> Iterator[tuple[T, "Future[R]"]]:
        """Yield each task with what became of it, in the order in which they end.

        `work` is called in a worker; `started` here, before a task is handed out. Tasks are taken
        from `tasks` only when a worker is free. When a worker is killed, every task that runs ends
        with BrokenProcessPool, none is taken any more, and this pool is of no use again.
        """
        waiting, running = iter(tasks), dict[Future[R], T]()
        more, broken = True, False
        while running or more:
            while more and len(running) < self._jobs:
                if broken or self._ending.is_set():
                    more = False
                    break
                try:
                    task = next(waiting)
                except StopIteration:
                    more = False
                    break
                started(task)
                running[self._submitted(work, task)] = task
            done, _ = wait(running, timeout=0.1, return_when=FIRST_COMPLETED)
            for future in done:
                broken |= isinstance(future.exception(), BrokenProcessPool)
                yield running.pop(future), future
            if self._interrupt.requested:
                self.end()
            self._hurry()

    def _submitted(self, work: Callable[[T], R], task: T) -> "Future[R]":
        try:
            with _signals_held_back():  # a worker starts inside submit
                return self._pool.submit(work, task)
        except BrokenProcessPool as error:  # a worker was killed just now
            lost: Future[R] = Future()
            lost.set_exception(error)
            return lost

    def _hurry(self) -> None:
        """Send SIGTERM to the workers after a second request to stop."""
        if self._interrupt.count > 1 and time.monotonic() >= self._again:
            for process in multiprocessing.active_children():
                if process.pid:
                    os.kill(process.pid, signal.SIGTERM)
            # once is not always enough: an exception raised in a finaliser is lost
            self._again = time.monotonic() + SIGNAL_AGAIN_S


@contextmanager
def _signals_held_back() -> Iterator[None]:
    """Block the signals in a process started inside the block, until `_start_worker`."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _SharedInterrupt(Interrupt):
    """An interrupt of a worker: an event is the first request, SIGTERM the second."""

    def __init__(self, ending: Event) -> None:
        super().__init__()
        self.ending = ending

    @property
    def requested(self) -> bool:
        return self.count > 0 or self.ending.is_set()

    def request(self) -> None:
        """Count two requests: a worker gets SIGTERM only as the second."""
        self.count = 2
        self._break()


_interrupt: Interrupt = Interrupt()


def worker_interrupt() -> Interrupt:
    """Return the interrupt of this worker process; one that nobody requests anywhere else."""
    return _interrupt


def _start_worker(ending: Event) -> None:
    """Prepare a worker: the parent alone acts on signals, and the worker ends when the parent does.

    A terminal sends its signals to every process; SIGTERM here is the parent's.
    """
    global _interrupt
    _interrupt = interrupt = _SharedInterrupt(ending)
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda number, frame: interrupt.request())
    sys.unraisablehook = interrupt.on_unraisable
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)  # delivers what came before
    threading.Thread(target=_outlive_nobody, name="parent", daemon=True).start()


def _outlive_nobody() -> None:
    """Wait for the end of the parent process, then end the trial, and this process soon after."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(ORPHAN_S)
    os._exit(1)
