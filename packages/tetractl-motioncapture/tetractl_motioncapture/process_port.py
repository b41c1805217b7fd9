"""The end of the library's process (`bridge`) in ours, used like a port.

The library waits for frames without a limit, and has ended the interpreter on streams that it
could not read; neither must reach the process that drives robots.
"""

import json
import signal
import subprocess
import sys
import time

from tetractl.core.errors import AbortError
from tetractl.lab.serial_port import Ports, SerialPort
from tetractl.lab.udp_port import SCHEME, open_port
from tetractl_motioncapture.section import MotionCaptureSection


class ProcessPort(SerialPort):
    """The library's process, read like a port: `heard` gets each line; `name` is its argument."""

    _process: subprocess.Popen[bytes] | None = None

    def open(self, alone: bool = True) -> None:
        """Start the process."""
        command = [sys.executable, "-m", "tetractl_motioncapture.bridge", self._name]
        self._process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, start_new_session=True
        )
        self._thread.start()

    def write(self, data: bytes) -> int:
        """Do nothing: the process sends frames unasked. AbortError if it has ended."""
        if self.failure:
            raise AbortError(self.failure, self._hint)
        return self._clock.now()

    def set_baud(self, baud: int) -> None:
        """Do nothing: a pipe has no baud rate."""

    def close(self) -> None:
        """End the process; may be called twice, never raises."""
        self._closing.set()
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        if self._thread.is_alive():
            self._thread.join(2.0)

    def _read(self) -> None:
        process = self._process
        assert process is not None and process.stdout is not None, "it was opened"
        with process.stdout as lines:
            for stamp, _, line in (each.partition(b" ") for each in lines):
                waited_ns = time.monotonic_ns() - int(stamp)  # in the pipe, as after a sleep
                self._heard(line, self._clock.now() - max(0, waited_ns))
        code = process.wait()
        if not self._closing.is_set():
            how = signal.strsignal(-code) if code < 0 else f"exit code {code}"
            self.failure = f"the process of {self._device} has ended: {how}"
            self._heard(b"", self._clock.now())


def ports_of(section: MotionCaptureSection) -> Ports:
    """Return what makes the port to a section's system: UDP to an emulated one."""
    if section.hostname.startswith(SCHEME):
        return open_port
    name = json.dumps([section.system, section.hostname, section.options])
    return lambda _, *rest: ProcessPort(name, *rest)
