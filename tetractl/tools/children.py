"""Start child processes of tetractl and its packages: tools, and other Python interpreters.

Only this module and `worker_pool` start processes. No code in the current folder is run: a Python
child starts with `-P`, or with PYTHONSAFEPATH if `multiprocessing` makes its command. So a
`json.py` next to a spec is not imported instead of Python's own. The standard error of a child does
not reach the terminal unchanged. Up to OUTPUT_BYTES_MAX of it are kept, made printable, and shown
with the name of the child.
"""

import os
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import IO, Self

from tetractl.core.errors import printable

OUTPUT_BYTES_MAX = 4096
"""Maximum number of bytes of a child's output that are kept. Only the last bytes are kept."""
SHOWN_LINE_MAX = 300
"""Maximum number of characters of a line of a child that are shown."""
READ_BYTES_MAX = 65536
"""Maximum number of bytes that are read from a pipe at a time."""
SAFE_PATH_VARIABLE = "PYTHONSAFEPATH"
"""Environment variable that keeps Python from importing modules from the current folder."""


def build_python_command(module: str, *arguments: str) -> list[str]:
    """Build the command that runs a Python module in a new process.

    The process uses the interpreter of this process. It does not search the current folder for
    modules.
    """
    return [sys.executable, "-P", "-m", module, *arguments]


class Child:
    """A child process that runs a command, and whose standard error is kept.

    See `subprocess.Popen` for its other attributes.

    Args:
        command: The program and its arguments.
        has_stdin: Whether `stdin` is a pipe. Otherwise, it is empty.
        own_session: Whether the process has its own session, which Ctrl-C in the terminal does not
            reach.
        environment: Environment variables to add to those of this process. None to add none.

    Raises:
        OSError: If the process cannot be started.
    """

    def __init__(
        self,
        command: Sequence[str],
        has_stdin: bool = False,
        own_session: bool = False,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self._process: subprocess.Popen[bytes] = subprocess.Popen(
            command,
            stdin=subprocess.PIPE if has_stdin else subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=own_session,
            env={**os.environ, **(environment or {})},
        )
        self._output = bytearray()
        self._listener = threading.Thread(target=self._listen, name="child", daemon=True)
        self._listener.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Kill the child process if it still runs, and close its pipes."""
        self.kill()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                with suppress(BrokenPipeError):  # the child has not read all its input
                    stream.close()

    @property
    def pid(self) -> int:
        """The id of the child process."""
        return self._process.pid

    @property
    def stdin(self) -> IO[bytes]:
        """The pipe through which the process receives its input. Needs `has_stdin`."""
        assert self._process.stdin is not None
        return self._process.stdin

    @property
    def stdout(self) -> IO[bytes]:
        """The pipe from which the output of the process is read."""
        assert self._process.stdout is not None
        return self._process.stdout

    def wait(self) -> int:
        """Wait until the process ends, and return its exit code.

        If a signal has ended the process, the result is minus the number of the signal.
        """
        return self._process.wait()

    def kill(self) -> None:
        """Kill the child process with SIGKILL, and wait until it is gone.

        Nothing happens if the process has already ended.
        """
        self._process.kill()
        self._process.wait()

    def error_lines(self) -> list[str]:
        """Return the last printable lines of the child's standard error, after the child has ended.

        A child process of the child may keep the pipe open. This method does not wait for it.
        """
        self._listener.join(1.0)
        return split_printable_lines(bytes(self._output))

    def _listen(self) -> None:
        """Read the child's standard error, and keep the last OUTPUT_BYTES_MAX bytes."""
        stream = self._process.stderr
        assert stream is not None
        with stream, suppress(OSError, ValueError):
            while data := os.read(stream.fileno(), READ_BYTES_MAX):
                self._output += data
                del self._output[:-OUTPUT_BYTES_MAX]


def run_tool(
    command: Sequence[str], timeout_s: float | None = None
) -> subprocess.CompletedProcess[bytes]:
    """Run a tool, such as git or a compiler, and wait until it ends.

    Raises:
        OSError: If the tool cannot be started, or does not end in time.
    """
    try:
        return subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, timeout=timeout_s
        )
    except subprocess.TimeoutExpired as error:
        raise TimeoutError(f"{command[0]} does not end") from error


def open_in_browser(address: str) -> bool:
    """Open an address in the browser, and return whether there is a browser."""
    import webbrowser

    return webbrowser.open(address)


def split_printable_lines(output: bytes) -> list[str]:
    """Split an output into non-empty lines, each made printable and cut to SHOWN_LINE_MAX letters.

    Bytes that are not UTF-8 are replaced.
    """
    lines = output.decode(errors="replace").splitlines()
    return [printable(line, SHOWN_LINE_MAX) for line in lines if line.strip()]
