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

from tetractl.tools.children import OUTPUT_BYTES_MAX, SAFE_PATH_VARIABLE, split_printable_lines

CallResult = TypeVar("CallResult")

LINES_MAX = 50
"""Maximum number of lines of all workers of a pool that are shown."""
RESTARTS_MAX = 50
"""Maximum number of attempts to start workers again."""
RESTART_WAIT_S = 0.1
"""Time before each attempt to start workers again [s]."""

_environment_lock = threading.RLock()


@contextmanager
def exclude_current_folder() -> Iterator[None]:
    """Let processes that start in the `with` block import nothing from the current folder.

    `multiprocessing` starts these processes. They inherit the environment variable
    PYTHONSAFEPATH.
    """
    with _environment_lock:
        previous_value = os.environ.get(SAFE_PATH_VARIABLE)
        os.environ[SAFE_PATH_VARIABLE] = "1"
        try:
            yield
        finally:
            if previous_value is None:
                del os.environ[SAFE_PATH_VARIABLE]
            else:
                os.environ[SAFE_PATH_VARIABLE] = previous_value


def create_clean_context(preload: Sequence[str] = ()) -> BaseContext:
    """Create a context that starts workers as new processes, not as copies of this process.

    Copies would have the locks that this process's threads hold. Modules in `preload` are imported
    only once for all workers, where that is possible.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():  # Windows
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(preload))
    return context


def create_fork_context() -> BaseContext:
    """Create a context that starts workers as copies of this process, by `fork`."""
    return multiprocessing.get_context("fork")


class WorkerPool:
    """A pool of worker processes, as a context manager.

    At the end of the `with` block, the pool waits for running calls, and drops calls that have not
    started.

    Args:
        context: Context of `multiprocessing` that starts the processes.
        workers: Number of processes.
        line_prefix: Text that is put before each line that a worker prints.
        print_line: Function that is called with each of these lines.
        prepare: Function that each process calls first. None to call nothing.
        arguments: Arguments of `prepare`.
    """

    def __init__(
        self,
        context: BaseContext,
        workers: int,
        line_prefix: str,
        print_line: Callable[[str], object],
        prepare: Callable[..., object] | None = None,
        arguments: tuple[Any, ...] = (),
    ) -> None:
        self._receiver, self._sender = context.Pipe(duplex=False)
        self._line_prefix = line_prefix
        self._print_line = print_line
        self._context: Any = context
        worker_arguments = self._sender, prepare, arguments
        self._pool = ProcessPoolExecutor(workers, context, _start_worker, worker_arguments)
        self._listener = threading.Thread(target=self._listen, name="workers", daemon=True)
        self._listener.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(cancel_futures=True)
        self._sender.close()
        self._listener.join(1.0)  # a worker's own child may keep the pipe open

    def submit(self, call: Callable[..., CallResult], *arguments: object) -> "Future[CallResult]":
        """Let a worker process call a function, and return the future result.

        If no worker can be started, for example because the server that starts them was killed, the
        future ends with BrokenProcessPool, as if a worker was killed.
        """
        try:
            with exclude_current_folder():
                return self._pool.submit(call, *arguments)
        except BrokenProcessPool as error:
            return _create_failed_future(error)
        except (OSError, EOFError) as error:
            self._wait_for_server()
            return _create_failed_future(BrokenProcessPool(str(error)))

    def _wait_for_server(self) -> None:
        """Wait until a process can be started again, for a limited time.

        `multiprocessing` replaces a server that was killed once the system has removed it.
        """
        for _ in range(RESTARTS_MAX):
            time.sleep(RESTART_WAIT_S)
            with suppress(OSError, EOFError), exclude_current_folder():
                probe = self._context.Process(target=int)
                probe.start()
                probe.join()
                return

    def _listen(self) -> None:
        """Print the lines that the workers write, up to LINES_MAX, in the listening thread."""
        line_count = 0
        with suppress(OSError), os.fdopen(os.dup(self._receiver.fileno()), "rb") as stream:
            while line := stream.readline(OUTPUT_BYTES_MAX):
                for shown_line in split_printable_lines(line):
                    line_count += 1
                    if line_count <= LINES_MAX:
                        self._print_line(f"{self._line_prefix}: {shown_line}")
                    elif line_count == LINES_MAX + 1:
                        self._print_line(
                            f"{self._line_prefix}: further output of this process is not shown"
                        )


def _create_failed_future(error: BrokenProcessPool) -> "Future[Any]":
    """Create a future that ends with an error."""
    future: Future[Any] = Future()
    future.set_exception(error)
    return future


def _start_worker(
    output: Connection, prepare: Callable[..., object] | None, arguments: tuple[Any, ...]
) -> None:
    """Redirect a worker's output to the pool's pipe, and call the function that prepares it."""
    for descriptor in (1, 2):
        os.dup2(output.fileno(), descriptor)
    output.close()
    # the old streams may contain text of another process, or be used by one of its threads
    sys.stdout = _open_line_stream(1)
    sys.stderr = _open_line_stream(2)
    if prepare is not None:
        prepare(*arguments)


def _open_line_stream(descriptor: int) -> TextIO:
    """Open a stream that writes each line to a descriptor at once."""
    return open(descriptor, "w", buffering=1, errors="backslashreplace", closefd=False)
