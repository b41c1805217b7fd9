"""The process that has a serial port for itself: who it is, and how it is made to let go."""

import os
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from tetractl.core.errors import AbortError

AGAIN_S, KILL_S, DEAD_S = 1.0, 4.0, 6.0  # a run ends at once at the second request
SWITCH_OFF = "switch the robots off by hand if they move"


def holder(port: str) -> int | None:
    """Return the process that has locked a port; None for none, or where Linux alone would say."""
    with suppress(OSError):
        at = Path(port).stat()
        device = f"{os.major(at.st_dev):02x}:{os.minor(at.st_dev):02x}:{at.st_ino}"
        for line in Path("/proc/locks").read_text().splitlines():
            words = line.split()  # 1: FLOCK ADVISORY WRITE pid device start end
            if words[1] == "FLOCK" and words[5] == device:
                return int(words[4])
    return None


def command_line(pid: int) -> list[str]:
    """Return the words that started a process; none where it has ended."""
    with suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="replace").split("\0")[:-1]
    return []


def stop_beside(port: str, stops: Callable[[], str], say: Callable[[str], None]) -> None:
    """Stop the robots of the run that has a port, then end that run, by SIGKILL if need be.

    `stops` sends stops past the run and returns what it did; it is repeated until the port is
    free, for a run that hangs may still drive. AbortError where the run is not ended: it is not
    known, another user's, or no tetractl.
    """
    began, failure, said = time.monotonic(), "", False
    pid = holder(port)
    due = [(KILL_S, signal.SIGKILL, "killed it: its log is cut short, see `tetractl recover`")]
    due.insert(0, (AGAIN_S, signal.SIGTERM, "asked it to end at once"))
    due.insert(0, (0.0, signal.SIGTERM, "asked it to stop its robots and end"))
    words = command_line(pid) if pid else []
    name = f"process {pid} ({' '.join(words)[:200]})" if pid else "another program"
    say(f"{port}: {name} has this port open")
    ours = any(Path(word).name == "tetractl" for word in words[:3])
    while True:
        if pid and ours and due and time.monotonic() - began >= due[0][0]:
            _, number, did = due.pop(0)
            with suppress(ProcessLookupError):
                try:
                    os.kill(pid, number)
                    os.kill(pid, signal.SIGCONT)  # suspended, it would not hear
                except PermissionError:
                    raise _left(name, "belongs to another user", stops, say) from None
            say(f"{did}, after {time.monotonic() - began:.1f} s")
        try:
            sent = stops()
        except AbortError as error:
            failure = str(error)
            time.sleep(0.05)
        else:
            if not said:
                say(f"{sent}, past it")
            said = True
        if pid is None or not ours:
            raise _left(name, "is no tetractl that could be ended" if pid else "is not known")
        if holder(port) != pid:
            say(f"it let go of the port after {time.monotonic() - began:.1f} s")
            return
        if time.monotonic() - began > DEAD_S:
            raise _left(name, f"does not end even by SIGKILL; {failure}")


def _left(
    name: str,
    why: str,
    stops: Callable[[], str] = lambda: "",
    say: Callable[[str], None] = lambda line: None,
) -> AbortError:
    """Return the error of a program that still has the port, after stops past it."""
    with suppress(AbortError):
        say(stops())
    return AbortError(f"{name} still has the port: it {why}", f"end it yourself; {SWITCH_OFF}")
