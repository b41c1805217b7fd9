"""Runs libmotioncapture in a child process (`bridge`), and reads the child's output like a port.

The library is kept out of the process that drives robots, for two reasons: it waits for frames
without a time limit, and it has crashed the interpreter on streams that it could not read.
"""

import signal

from tetractl.core.clock import host_ns
from tetractl.core.errors import AbortError
from tetractl.lab.client_port import ClientPort
from tetractl.tools.children import Child, build_python_command


class ProcessPort(ClientPort):
    """Runs the library in a child process, and passes each line of its output to a callback.

    Args:
        name: The child's argument: a JSON array of the system, its hostname and its options.
        heard: Called in the reader's thread with each line and its time [ns].

    The other arguments are described in `SerialPort`.
    """

    _process: Child | None = None

    def open(self, exclusive: bool = True) -> None:
        """Start the child process and the thread that reads its output."""
        self._process = Child(
            build_python_command("tetractl_motioncapture.bridge", self._name), own_session=True
        )
        super().open(exclusive)

    def connect(self) -> None:
        """Do nothing, because the child process connects to the motion-capture system."""

    def wait(self) -> None:
        """Wait for the next line of the child's output, and pass it on.

        The time that the line spent in the pipe is subtracted from its time of arrival.

        Raises:
            AbortError: If the child process has ended. The message contains its exit code or
                signal.
        """
        assert self._process is not None, "it was opened"
        line = self._process.stdout.readline()
        if not line:
            code = self._process.wait()
            if code < 0:
                reason = signal.strsignal(-code) or f"signal {-code}"
            else:
                reason = ": ".join([f"exit code {code}", *self._process.error_lines()[-1:]])
            raise AbortError(f"the process that reads {self._device} has stopped: {reason}")
        stamp_ns, _, message = line.partition(b" ")
        # in the pipe, as after a sleep
        waited_ns = max(0, host_ns() - int(stamp_ns))
        self.take(message, waited_ns)

    def disconnect(self) -> None:
        """Close the pipe from the child process."""
        if self._process is not None:
            self._process.stdout.close()

    def close(self) -> None:
        """Kill the child process. This method can be called repeatedly and never raises."""
        self._closing.set()
        if self._process is not None:
            self._process.kill()
        super().close()
