"""A pool of worker processes, which make calls for this process.

`children` starts all other child processes, and explains the rules for all of them.
"""

import multiprocessing
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext
from typing import Any, Self, TextIO, TypeVar

from tetractl.tools.children import SAFE_PATH, SAID_BYTES, shown_lines

R = TypeVar("R")

LINES_MAX = 50
"""Maximum number of lines of all workers of a pool that are shown."""
STARTS_MAX = 50
"""Maximum number of attempts to start workers again."""
START_S = 0.1
"""Time before each of these attempts [s]."""

_starting = threading.RLock()


@contextmanager
def isolated() -> Iterator[None]:
    """Start processes in the block such that they import nothing from the current folder.

    `multiprocessing` starts these processes, which inherit an environment variable.
    """
    with _starting:
        before = os.environ.get(SAFE_PATH)
        os.environ[SAFE_PATH] = "1"
        try:
            yield
        finally:
            if before is None:
                del os.environ[SAFE_PATH]
            else:
                os.environ[SAFE_PATH] = before


def fresh_context(preload: Sequence[str] = ()) -> BaseContext:
    """Create a context that starts workers as new processes, not as copies of this process.

    Copies would have the locks that this process's threads hold. Modules in `preload` are imported
    only once for all workers, where that is possible.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():  # Windows
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(preload))
    return context


def copying_context() -> BaseContext:
    """Create a context that starts workers as copies of this process, by `fork`."""
    return multiprocessing.get_context("fork")


class WorkerPool:
    """A pool of worker processes, as a context manager.

    At its end, it waits for running calls, and drops those that have not begun.

    Args:
        context: Starts the processes.
        workers: Number of processes.
        who: Put before each line that a worker prints.
        tell: Called with each of these lines.
        prepare: Called first in each process. None for nothing.
        arguments: Arguments of `prepare`.
    """

    def __init__(
        self,
        context: BaseContext,
        workers: int,
        who: str,
        tell: Callable[[str], object],
        prepare: Callable[..., object] | None = None,
        arguments: tuple[Any, ...] = (),
    ) -> None:
        self._receiver, self._sender = context.Pipe(duplex=False)
        self._who = who
        self._tell = tell
        self._context: Any = context
        start = self._sender, prepare, arguments
        self._pool = ProcessPoolExecutor(workers, context, _start_worker, start)
        self._listener = threading.Thread(target=self._listen, name="workers", daemon=True)
        self._listener.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(cancel_futures=True)
        self._sender.close()
        self._listener.join(1.0)  # a worker's own child may keep the pipe open

    def submit(self, call: Callable[..., R], *arguments: object) -> "Future[R]":
        """Let a worker make a call.

        If no worker can be started, for example because the server that starts them was killed, the
        future ends with BrokenProcessPool, as if a worker was killed.
        """
        try:
            with isolated():
                return self._pool.submit(call, *arguments)
        except BrokenProcessPool as error:
            return _lost(error)
        except (OSError, EOFError) as error:
            self._wait_for_server()
            return _lost(BrokenProcessPool(str(error)))

    def _wait_for_server(self) -> None:
        """Wait until a process can be started again, for a limited time.

        `multiprocessing` replaces a server that was killed once the system has removed it.
        """
        for _ in range(STARTS_MAX):
            time.sleep(START_S)
            with suppress(OSError, EOFError), isolated():
                probe = self._context.Process(target=int)
                probe.start()
                probe.join()
                return

    def _listen(self) -> None:
        lines = 0
        with suppress(OSError), os.fdopen(os.dup(self._receiver.fileno()), "rb") as stream:
            while line := stream.readline(SAID_BYTES):
                for text in shown_lines(line):
                    lines += 1
                    if lines <= LINES_MAX:
                        self._tell(f"{self._who}: {text}")
                    elif lines == LINES_MAX + 1:
                        self._tell(f"{self._who}: further output of this process is not shown")


def _lost(error: BrokenProcessPool) -> "Future[Any]":
    lost: Future[Any] = Future()
    lost.set_exception(error)
    return lost


def _start_worker(
    output: Connection, prepare: Callable[..., object] | None, arguments: tuple[Any, ...]
) -> None:
    for descriptor in (1, 2):
        os.dup2(output.fileno(), descriptor)
    output.close()
    # the streams before may have text of another process, or be written by a thread of it
    sys.stdout = _lines_to(1)
    sys.stderr = _lines_to(2)
    if prepare is not None:
        prepare(*arguments)


def _lines_to(descriptor: int) -> TextIO:
    return open(descriptor, "w", buffering=1, errors="backslashreplace", closefd=False)
