"""The end of the library's process (`bridge`) in ours, used like a port.

The library waits for frames without a limit, and has ended the interpreter on streams that it
could not read; neither must reach the process that drives robots.
"""

import signal

from tetractl.core.clock import host_ns
from tetractl.core.errors import AbortError
from tetractl.lab.client_port import ClientPort
from tetractl.tools.children import Child, python


class ProcessPort(ClientPort):
    """The library's process, read like a port. `on_received` gets each line of its output.

    `name` is its argument.
    """

    _process: Child | None = None

    def open(self, alone: bool = True) -> None:
        """Start the process."""
        self._process = Child(python("tetractl_motioncapture.bridge", self._name), alone=True)
        super().open(alone)

    def connect(self) -> None:
        """Do nothing: the process connects."""

    def wait(self) -> None:
        """Wait for the next line.

        Raises:
            AbortError: If the process has ended.
        """
        assert self._process is not None, "it was opened"
        line = self._process.stdout.readline()
        if not line:
            code = self._process.wait()
            if code < 0:
                why = signal.strsignal(-code) or f"signal {-code}"
            else:
                why = ": ".join([f"exit code {code}", *self._process.error_lines()[-1:]])
            raise AbortError(f"the process of {self._device} has ended: {why}")
        stamp, _, message = line.partition(b" ")
        # in the pipe, as after a sleep
        waited_ns = max(0, host_ns() - int(stamp))
        self.take(message, waited_ns)

    def disconnect(self) -> None:
        """Close the pipe."""
        if self._process is not None:
            self._process.stdout.close()

    def close(self) -> None:
        """End the process; may be called twice, never raises."""
        self._closing.set()
        if self._process is not None:
            self._process.kill()
        super().close()
