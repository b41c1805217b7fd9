"""Starts every child process of tetractl and of its packages; nothing else does.

Nothing of the present folder is run: a Python child starts with `-P`, or with PYTHONSAFEPATH where
`multiprocessing` makes its command, so that a `json.py` next to a spec is not imported as Python's.
What a child says on its standard error does not reach the terminal as it is: it is kept up to
SAID_BYTES, made printable, and shown with the name of who said it.
"""

import multiprocessing
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext
from typing import IO, Any, Self, TextIO, TypeVar

from tetractl.core.errors import printable

R = TypeVar("R")

SAID_BYTES = 4096
"""Most that is kept of what a child says: its last bytes."""
SHOWN_LINE_MAX = 300
"""Most characters of a line of a child that are shown."""
LINES_MAX = 50
"""Most lines of all workers of a pool that are shown."""
READ_BYTES = 65536
"""Most bytes that are read of a pipe at a time."""
STARTS_MAX = 50
"""How often it is tried whether workers can be started again."""
START_S = 0.1
"""Time before each of these attempts [s]."""
SAFE_PATH = "PYTHONSAFEPATH"
"""The environment variable by which Python does not import from the present folder."""


def python(module: str, *arguments: str) -> list[str]:
    """Return the command that runs a module in another Python, without the present folder."""
    return [sys.executable, "-P", "-m", module, *arguments]


class Child:
    """A process of `command`, whose standard error is kept; see `subprocess.Popen` for the others.

    `stdin` is a pipe if `fed`, else empty. `alone` gives it a session of its own, which Ctrl-C of
    the terminal does not reach. `environment` is added to this process's. OSError if it cannot be
    started.
    """

    def __init__(
        self,
        command: Sequence[str],
        fed: bool = False,
        alone: bool = False,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self._process: subprocess.Popen[bytes] = subprocess.Popen(
            command,
            stdin=subprocess.PIPE if fed else subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=alone,
            env={**os.environ, **(environment or {})},
        )
        self._said = bytearray()
        self._listener = threading.Thread(target=self._listen, name="child", daemon=True)
        self._listener.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """End it, and close its pipes."""
        self.kill()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                with suppress(BrokenPipeError):  # it has not read what it was given
                    stream.close()

    @property
    def pid(self) -> int:
        """The id of the process."""
        return self._process.pid

    @property
    def stdin(self) -> IO[bytes]:
        """The pipe to a process that is `fed`."""
        assert self._process.stdin is not None
        return self._process.stdin

    @property
    def stdout(self) -> IO[bytes]:
        """The pipe of what it prints."""
        assert self._process.stdout is not None
        return self._process.stdout

    def wait(self) -> int:
        """Wait until it ends; return its exit code, or less than 0 the number of a signal."""
        return self._process.wait()

    def kill(self) -> None:
        """End it; may be called twice."""
        self._process.kill()
        self._process.wait()

    def said(self) -> list[str]:
        """Return the last printable lines on its standard error, after it has ended.

        A child of its own may keep the pipe open: it is not waited for.
        """
        self._listener.join(1.0)
        return shown_lines(bytes(self._said))

    def _listen(self) -> None:
        stream = self._process.stderr
        assert stream is not None
        with stream, suppress(OSError, ValueError):
            while data := os.read(stream.fileno(), READ_BYTES):
                self._said += data
                del self._said[:-SAID_BYTES]


def run_tool(
    command: Sequence[str], patience_s: float | None = None
) -> subprocess.CompletedProcess[bytes]:
    """Run a tool, such as git or a compiler, to its end; OSError if it cannot be started, or does
    not end within `patience_s`. What it says is for `shown_lines`."""
    try:
        return subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, timeout=patience_s
        )
    except subprocess.TimeoutExpired as error:
        raise TimeoutError(f"{command[0]} does not end") from error


def open_in_browser(address: str) -> bool:
    """Open an address in the browser; return whether there is one."""
    import webbrowser

    return webbrowser.open(address)


def shown_lines(said: bytes) -> list[str]:
    """Return the lines of a text that are not empty, each printable and of SHOWN_LINE_MAX."""
    lines = said.decode(errors="replace").splitlines()
    return [printable(line, SHOWN_LINE_MAX) for line in lines if line.strip()]


_starting = threading.RLock()


@contextmanager
def isolated() -> Iterator[None]:
    """Let Python processes that `multiprocessing` starts in the block import nothing of the present
    folder: they take the variable from this process."""
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
    """Return what starts workers that are no copies of this process, which would have the locks
    that its threads hold; modules in `preload` are imported once for all, where that is possible.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():  # Windows
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(preload))
    return context


def copying_context() -> BaseContext:
    """Return what starts workers that are copies of this process."""
    return multiprocessing.get_context("fork")


class WorkerPool:
    """A pool of processes, each of which calls `prepare(*arguments)` first; a context manager.

    What workers print or say is passed to `tell`, a line at a time, after `who`. At its end running
    calls are waited for, and those that wait are dropped.
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
        self._heard, self._said = context.Pipe(duplex=False)
        self._who = who
        self._tell = tell
        self._context: Any = context
        start = self._said, prepare, arguments
        self._pool = ProcessPoolExecutor(workers, context, _start_worker, start)
        self._listener = threading.Thread(target=self._listen, name="workers", daemon=True)
        self._listener.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(cancel_futures=True)
        self._said.close()
        self._listener.join(1.0)  # a worker's own child may keep the pipe open

    def submit(self, call: Callable[..., R], *arguments: object) -> "Future[R]":
        """Let a worker make a call. If none can be started, as when the server that starts them was
        killed, the future ends as it does when a worker was: with BrokenProcessPool."""
        try:
            with isolated():
                return self._pool.submit(call, *arguments)
        except BrokenProcessPool as error:
            return _lost(error)
        except (OSError, EOFError) as error:
            self._wait_for_server()
            return _lost(BrokenProcessPool(str(error)))

    def _wait_for_server(self) -> None:
        """Wait until a process can be started again, at most some time: `multiprocessing` replaces
        a server that was killed once the system has removed it."""
        for _ in range(STARTS_MAX):
            time.sleep(START_S)
            with suppress(OSError, EOFError), isolated():
                probe = self._context.Process(target=int)
                probe.start()
                probe.join()
                return

    def _listen(self) -> None:
        lines = 0
        with suppress(OSError), os.fdopen(os.dup(self._heard.fileno()), "rb") as stream:
            while line := stream.readline(SAID_BYTES):
                for text in shown_lines(line):
                    lines += 1
                    if lines <= LINES_MAX:
                        self._tell(f"{self._who}: {text}")
                    elif lines == LINES_MAX + 1:
                        self._tell(f"{self._who}: says more, which is not shown")


def _lost(error: BrokenProcessPool) -> "Future[Any]":
    lost: Future[Any] = Future()
    lost.set_exception(error)
    return lost


def _start_worker(
    said: Connection, prepare: Callable[..., object] | None, arguments: tuple[Any, ...]
) -> None:
    for descriptor in (1, 2):
        os.dup2(said.fileno(), descriptor)
    said.close()
    # the streams before may have text of another process, or be written by a thread of it
    sys.stdout = _lines_to(1)
    sys.stderr = _lines_to(2)
    if prepare is not None:
        prepare(*arguments)


def _lines_to(descriptor: int) -> TextIO:
    return open(descriptor, "w", buffering=1, errors="backslashreplace", closefd=False)
