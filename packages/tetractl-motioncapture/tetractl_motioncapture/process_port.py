"""The end of the library's process (`bridge`) in ours, used like a port.

The library waits for frames without a limit, and has ended the interpreter on streams that it
could not read; neither must reach the process that drives robots.
"""

import signal
import subprocess
import sys

from tetractl.core.clock import host_ns
from tetractl.core.errors import AbortError
from tetractl.lab.client_port import ClientPort


class ProcessPort(ClientPort):
    """The library's process, read like a port: `heard` gets each line; `name` is its argument."""

    _process: subprocess.Popen[bytes] | None = None

    def open(self, alone: bool = True) -> None:
        """Start the process."""
        command = [sys.executable, "-m", "tetractl_motioncapture.bridge", self._name]
        self._process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, start_new_session=True
        )
        super().open(alone)

    def connect(self) -> None:
        """Do nothing: the process connects."""

    def wait(self) -> None:
        """Take the next line; AbortError if the process has ended."""
        assert self._process is not None and self._process.stdout is not None, "it was opened"
        if not (line := self._process.stdout.readline()):
            code = self._process.wait()
            how = signal.strsignal(-code) if code < 0 else f"exit code {code}"
            raise AbortError(f"the process of {self._device} has ended: {how}")
        stamp, _, message = line.partition(b" ")
        # in the pipe, as after a sleep
        self.take(message, max(0, host_ns() - int(stamp)))

    def disconnect(self) -> None:
        """Close the pipe."""
        if self._process is not None and self._process.stdout is not None:
            self._process.stdout.close()

    def close(self) -> None:
        """End the process; may be called twice, never raises."""
        self._closing.set()
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        super().close()
