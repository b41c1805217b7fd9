"""Find the process that keeps a serial port open, stop its robots, and end the process."""

import os
import signal
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from tetractl.core.errors import AbortError
from tetractl.lab.serial_port import SWITCH_OFF

ENDING_SIGNALS = (
    (signal.SIGTERM, "asked the process to stop its robots and to end", 1.0),
    (signal.SIGTERM, "asked the process to end at once", 4.0),
    (signal.SIGKILL, "killed the process; `tetractl recover` repairs its log", 6.0),
)
"""The signals sent to a process that has the port, in order.

Each comes with a description, and with the time from the beginning until which stops are sent after
it [s].
"""


def holder(port: str) -> int | None:
    """Return the id of the process that has locked a port.

    None if no process has locked it, and on systems other than Linux.
    """
    with suppress(OSError):
        status = Path(port).stat()
        device = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
        for line in Path("/proc/locks").read_text().splitlines():
            words = line.split()  # 1: FLOCK ADVISORY WRITE pid device start end
            if words[1] == "FLOCK" and words[5] == device:
                return int(words[4])
    return None


def command_line(pid: int) -> list[str]:
    """Return the command line of a process as a list. Empty if it cannot be read."""
    with suppress(OSError):
        line = Path(f"/proc/{pid}/cmdline").read_bytes()
        return line.decode(errors="replace").split("\0")[:-1]
    return []


def stop_beside(port: str, stops: Callable[[], str], say: Callable[[str], None]) -> None:
    """Stop robots whose port another run keeps open, and end that run, if necessary by SIGKILL.

    Args:
        port: The port.
        stops: Sends stops on the port, and returns a summary. It is called until the port is free,
            because a run that hangs may still drive robots.
        say: Prints a line, after the first stops. It must not raise.

    Raises:
        AbortError: If the process that has the port open cannot be ended, because it is unknown,
            belongs to another user, or is not tetractl.
    """
    began_s = time.monotonic()
    pid = holder(port)
    words = command_line(pid) if pid else []
    name = f"process {pid} ({' '.join(words)[:200]})" if pid else "another program"
    unendable = _why_unendable(pid, words)
    stopping = _StopsBeside(stops, say, f"{port}: {name} has this port open")
    for number, did, until_s in ENDING_SIGNALS:
        unendable = unendable or _end(pid, number)
        if unendable:
            stopping.send()
            break
        stopping.note(f"{did}, after {time.monotonic() - began_s:.1f} s")
        while True:  # once after each signal, however long stops take
            stopping.send()
            passed_s = time.monotonic() - began_s
            if holder(port) != pid:
                say(f"the process released the port after {passed_s:.1f} s")
                return
            if passed_s >= until_s:
                break
    else:
        unendable = "does not end even after SIGKILL"
    text = f"{name} still has the port open: it {unendable}"
    if stopping.failure:
        text += f"; the stops failed as well: {stopping.failure}"
    raise AbortError(text, f"end the process yourself; {SWITCH_OFF}")


class _StopsBeside:
    """Sends stops while another process has the port open.

    It also reports its actions, but only after the first stop. `failure` is the reason why the
    newest stop could not be sent to all robots.
    """

    def __init__(self, stops: Callable[[], str], say: Callable[[str], None], line: str) -> None:
        self.failure = ""
        self._stops = stops
        self._say = say
        self._unsaid = [line]
        self._all_heard = False

    def note(self, line: str) -> None:
        """Add a line that is reported after the next stops."""
        self._unsaid.append(line)

    def send(self) -> None:
        """Send stops, and then report the lines that were added."""
        try:
            summary = self._stops()
        except AbortError as error:
            self.failure = error.message
            time.sleep(0.05)
        else:
            self.failure = ""
            if not self._all_heard:
                self.note(f"{summary}, while this process has the port open")
            self._all_heard = True
        while self._unsaid:
            self._say(self._unsaid.pop(0))


def _end(pid: int | None, number: signal.Signals) -> str:
    """Send a signal to a process.

    Returns:
        Why that is not allowed, as the end of a sentence. Empty if it was sent or not needed.
    """
    assert pid is not None  # else it is unknown, and not ended
    with suppress(ProcessLookupError):
        try:
            os.kill(pid, number)
            os.kill(pid, signal.SIGCONT)  # a suspended process would not receive signals
        except PermissionError:
            return "cannot be ended, because it belongs to another user"
    return ""


def _why_unendable(pid: int | None, words: Sequence[str]) -> str:
    """Explain why this program must not end a process with this command line.

    Empty if it may.
    """
    if pid is None:
        return "is unknown"
    if any(Path(word).name == "tetractl" for word in words[:3]):
        return ""
    return "is not a tetractl process, so it is not ended"
