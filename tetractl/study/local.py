"""Runs the trials of a study on this machine, in this process or in several."""

from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

from tetractl.core.errors import AbortError
from tetractl.run.interrupt import Interrupt
from tetractl.run.pool import Pool, worker_interrupt
from tetractl.study.row import Row
from tetractl.study.work import Task, run_task

Ended = tuple[Task, Row | Exception | None]
"""A task, and its row; what kept it from its end; None where it was interrupted."""


class Local:
    """Runs `jobs` trials at a time. `place` returns the folder for the log of a task.

    When a process is killed, the trials that ran are run again, each by itself; one whose process
    is killed again has failed.
    """

    def __init__(self, jobs: int, interrupt: Interrupt, place: Callable[[Task], Path]) -> None:
        self.workers = jobs
        self._interrupt, self._place = interrupt, place
        self._pool: Pool | None = None
        self._ended = False

    def run(self, tasks: Sequence[Task]) -> Generator[Ended]:
        """Yield the tasks in the order in which they end."""
        if self.workers == 1:
            yield from self._here(tasks)
            return
        waiting = deque(tasks)
        while waiting and not self._stopping:
            suspects: list[Task] = []
            for task, found in self._in_pool(waiting, self.workers):
                if isinstance(found, BrokenProcessPool):
                    suspects.append(task)
                else:
                    yield task, found
            for suspect in suspects:
                for task, found in self._in_pool(deque([suspect]), 1):
                    lost = isinstance(found, BrokenProcessPool)
                    why = "its process was killed, perhaps for want of memory"
                    yield task, AbortError(why) if lost else found

    def end(self) -> None:
        """Start no further trial, and let those that run end early."""
        self._ended = True
        if self._pool is not None:
            self._pool.end()

    @property
    def _stopping(self) -> bool:
        return self._ended or self._interrupt.requested

    def _here(self, tasks: Sequence[Task]) -> Iterator[Ended]:
        for task in tasks:
            if self._stopping:
                return
            try:
                found = run_task(task, self._place(task), self._interrupt)
            except Exception as error:
                found = error
            yield task, found

    def _in_pool(self, waiting: "deque[Task]", jobs: int) -> Iterator[Ended]:
        with Pool(jobs, self._interrupt) as pool:
            self._pool = pool
            for (task, _), future in pool.run(_work, self._placed(waiting)):
                error = future.exception()
                if error is not None and not isinstance(error, Exception):
                    raise error
                yield task, error or future.result()

    def _placed(self, waiting: "deque[Task]") -> Iterator[tuple[Task, Path]]:
        while waiting:
            task = waiting.popleft()
            yield task, self._place(task)


def _work(item: tuple[Task, Path]) -> Row | None:
    return run_task(*item, worker_interrupt())
