"""Find the process that keeps a serial port open, stop its robots, and end the process."""

import os
import signal
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from tetractl.core.errors import AbortError
from tetractl.lab.serial_port import SWITCH_OFF_HINT

ENDING_SIGNALS = (
    (signal.SIGTERM, "asked the process to stop its robots and to end", 1.0),
    (signal.SIGTERM, "asked the process to end at once", 4.0),
    (signal.SIGKILL, "killed the process; `tetractl recover` repairs its log", 6.0),
)
"""The signals that end a process with an open port, in the order in which they are sent.

Each row has the signal, a description for the operator, and the time at which the next signal
follows if the process has not ended [s]. This time counts from the first stop. Until then, stops
are sent again and again.
"""


def find_holder(port: str) -> int | None:
    """Find the process that has locked a port, and return its id.

    The result is None if no process has locked the port, and on systems other than Linux.
    """
    with suppress(OSError):
        status = Path(port).stat()
        file_id = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
        for line in Path("/proc/locks").read_text().splitlines():
            lock_fields = line.split()  # 1: FLOCK ADVISORY WRITE pid device start end
            if lock_fields[1] == "FLOCK" and lock_fields[5] == file_id:
                return int(lock_fields[4])
    return None


def command_line(pid: int) -> list[str]:
    """Return the command line of a process as a list. The list is empty if it cannot be read."""
    with suppress(OSError):
        line = Path(f"/proc/{pid}/cmdline").read_bytes()
        return line.decode(errors="replace").split("\0")[:-1]
    return []


def stop_and_end_holder(
    port: str, send_stops: Callable[[], str], report: Callable[[str], None]
) -> None:
    """Stop robots whose port another run keeps open, and end that run, if necessary by SIGKILL.

    Args:
        port: The file that the other run has locked: the port, or the lock file of a UDP port.
        send_stops: Sends stops on the port, and returns a summary. It is called until the port is
            free, because a run that hangs may still drive robots.
        report: Shows a line to the operator. It must not raise. It is not called before the first
            stops are sent.

    Raises:
        AbortError: If the process that has the port open cannot be ended, because it is unknown,
            belongs to another user, or is not tetractl.
    """
    start_s = time.monotonic()
    pid = find_holder(port)
    arguments = command_line(pid) if pid else []
    name = f"process {pid} ({' '.join(arguments)[:200]})" if pid else "another program"
    obstacle = _explain_unendable(pid, arguments)
    stopping = _StopSender(send_stops, report, f"{port}: {name} has this port open")
    for signal_number, description, end_s in ENDING_SIGNALS:
        obstacle = obstacle or _send_signal(pid, signal_number)
        if obstacle:
            stopping.send()
            break
        stopping.add_line(f"{description}, after {time.monotonic() - start_s:.1f} s")
        while True:  # once after each signal, however long stops take
            stopping.send()
            elapsed_s = time.monotonic() - start_s
            if find_holder(port) != pid:
                report(f"the process released the port after {elapsed_s:.1f} s")
                return
            if elapsed_s >= end_s:
                break
    else:
        obstacle = "does not end even after SIGKILL"
    problem = f"{name} still has the port open: it {obstacle}"
    if stopping.failure:
        problem += f"; the stops failed as well: {stopping.failure}"
    raise AbortError(problem, f"end the process yourself; {SWITCH_OFF_HINT}")


class _StopSender:
    """Sends stops while another process has the port open, and reports progress to the operator.

    Lines are reported only after the first stop, so that they cannot delay it.

    Attributes:
        failure: Why the newest stop could not be sent to all robots. Empty if it was sent.
    """

    def __init__(
        self, send_stops: Callable[[], str], report: Callable[[str], None], line: str
    ) -> None:
        self.failure = ""
        self._send_stops = send_stops
        self._report = report
        self._pending_lines = [line]
        self._has_reported_stops = False

    def add_line(self, line: str) -> None:
        """Add a line for the operator. It is reported after the next stops."""
        self._pending_lines.append(line)

    def send(self) -> None:
        """Send stops, and then report the lines that were added since the last stops."""
        try:
            summary = self._send_stops()
        except AbortError as error:
            self.failure = error.message
            time.sleep(0.05)
        else:
            self.failure = ""
            if not self._has_reported_stops:
                self.add_line(f"{summary}, while this process has the port open")
            self._has_reported_stops = True
        while self._pending_lines:
            self._report(self._pending_lines.pop(0))


def _send_signal(pid: int | None, signal_number: signal.Signals) -> str:
    """Send a signal to a process.

    Returns:
        Why this is not allowed, as the end of a sentence. Empty if the signal was sent, or if the
        process has ended already.
    """
    assert pid is not None  # an unknown process is not ended
    with suppress(ProcessLookupError):
        try:
            os.kill(pid, signal_number)
            os.kill(pid, signal.SIGCONT)  # a suspended process would not receive signals
        except PermissionError:
            return "cannot be ended, because it belongs to another user"
    return ""


def _explain_unendable(pid: int | None, arguments: Sequence[str]) -> str:
    """Explain why this program must not end a process with a command line.

    The result is the end of a sentence. It is empty if the process may be ended.
    """
    if pid is None:
        return "is unknown"
    if any(Path(word).name == "tetractl" for word in arguments[:3]):
        return ""
    return "is not a tetractl process, so it is not ended"
