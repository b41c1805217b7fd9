"""Faults of the process that drives the robots: signals, a full disk, a busy host, a second run.

In virtual time they act inside this process, at their tick, and its clock and its plant ask which
do; in real time on the process that has locked the actuator's port, as far as another process can.
"""

import os
import resource
import signal
from collections.abc import Callable
from contextlib import suppress
from errno import ENOSPC
from typing import Annotated, Any, Literal

from pydantic import Field

from tetractl.core.clock import SECOND, Clock
from tetractl.core.errors import AbortError
from tetractl.core.protocols import LabSupervision
from tetractl.lab.port_holder import holder
from tetractl.lab.serial_port import Ports, SerialPort
from tetractl.spec.base import Positive
from tetractl_emulator.fault_rows import (
    CELLS,
    LATE,
    MOVED,
    NOTHING,
    FaultRow,
    between,
    one_of,
)
from tetractl_emulator.faults import fault_kind, switching

AFTER_NS = SECOND
"""Time for which an emulated lab goes on after the process has ended [ns]: robots come to rest."""
SIGNALS = Literal["INT", "TERM", "HUP", "QUIT", "KILL"]


class Process:
    """The process that drives the robots of an emulated lab.

    It has locked the port of the actuator. If no process has, nothing is done.

    Args:
        lab: The section of the lab in the spec.
        clock: The clock for times.
        ports: Opens the port of the actuator.
    """

    def __init__(self, lab: Any, clock: Clock, ports: Ports = SerialPort) -> None:
        self._lab = lab
        self._clock = clock
        self._ports = ports

    def signal(self, name: str) -> None:
        """Send the process a signal. Its name has no prefix SIG."""
        self._act(lambda pid: os.kill(pid, signal.Signals[f"SIG{name}"]))

    def stop(self, on: bool) -> None:
        """Suspend the process as SIGSTOP and a computer's sleep do, or let it continue."""
        self._act(lambda pid: os.kill(pid, signal.SIGSTOP if on else signal.SIGCONT))

    def fill_disk(self) -> None:
        """Make every write of the process to a file fail completely.

        No write is cut short, because Python 3.11 keeps partly written bytecode of a module, and
        the next process may fail on it.
        """
        self._act(lambda pid: resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, 0)))

    def press_stop(self) -> None:
        """Do nothing: another process cannot press the key of the emergency stop."""

    def _act(self, act: Callable[[int], object]) -> None:
        with suppress(OSError):
            if pid := holder(self._lab.port):
                act(pid)

    def run_again(self) -> None:
        """Let a second run open the port; record the answer, "" if the port opens."""
        again = (self._lab.port, 57600, "the second run", self._clock, lambda *_: None, "")
        second = self._ports(*again)
        says = ""
        try:
            second.open()
        except AbortError as error:
            says = error.message
        else:
            second.close()
        self._lab.note("second", says=says)


class ThisProcess(Process):
    """This process, in virtual time, as the process that drives the robots.

    Args:
        lab: The section of the lab in the spec.
        ports: Opens the port of the actuator.
        clock: The virtual clock.
        supervision: How people supervise the trial.
        outlive: Lets the emulated lab continue alone, and closes it.
    """

    def __init__(
        self,
        lab: Any,
        ports: Ports,
        clock: Clock,
        supervision: LabSupervision,
        outlive: Callable[[Any], None],
    ) -> None:
        super().__init__(lab, clock, ports)
        self._supervision = supervision
        self._outlive = outlive

    def signal(self, name: str) -> None:
        """Take a signal as its handler does; after SIGKILL only the emulation goes on."""
        if name != "KILL":
            self._supervision.signalled()
            return
        self._outlive(self._lab)
        os.kill(os.getpid(), signal.SIGKILL)

    def stop(self, on: bool) -> None:
        """Do nothing: the clock stands still while the fault acts."""

    def fill_disk(self) -> None:
        """Let the log's next write fail."""
        self._supervision.fail_log(OSError(ENOSPC, os.strerror(ENOSPC)))

    def press_stop(self) -> None:
        """Set the event of the key."""
        self._supervision.emergency.set()


STANDS = f"stood still|late|{CELLS}|{LATE}"  # cells seem to stand still meanwhile
ASLEEP = f"{STANDS}|{MOVED}"
PROCESS_FAULTS = (
    fault_kind(
        "signal",
        "The process that drives the robots gets this signal.",
        fields={"signal": SIGNALS},
        rows=[
            FaultRow("killed", NOTHING, {"signal": "KILL"}, at_once=True),
            FaultRow(
                "signal",
                "interrupted|cancelled",
                {"signal": one_of("INT", "TERM", "HUP", "QUIT")},
                at_once=True,
            ),
        ],
        begin=lambda f, p: p.signal(f.signal),
    ),
    fault_kind(
        "stopped",
        "That process is suspended, or sleeps.",
        rows=[
            FaultRow("suspended", ASLEEP, {"for": between(0.02, 5)}),
            FaultRow("computer sleeps", ASLEEP, {"for": one_of(3.0, 30.0)}),
        ],
        begin=switching(lambda f, p: p.stop),
    ),
    fault_kind(
        "disk_full",
        "The disk for the log is full.",
        rows=[FaultRow("disk full", "cannot write the log", at_once=True)],
        begin=lambda f, p: p.fill_disk(),
    ),
    fault_kind(
        "host_clock",
        "The computer's monotonic clock jumps by this time [s]; only in virtual time.",
        fields={"by": Positive},
        rows=[FaultRow("host's clock jumps", STANDS, {"by": between(0.02, 6)}, at_once=True)],
    ),
    fault_kind(
        "busy",
        "Each plan, or one of `every` plans, takes this time [s]; only in virtual time.",
        fields={"seconds": Positive, "every": (Annotated[int, Field(ge=1)], 1)},
        rows=[
            FaultRow("host busy", f"late|silent|{MOVED}", {"seconds": between(0.01, 6)}),
            FaultRow(
                "host busy at times",
                f"late|silent|{MOVED}",
                {"seconds": between(0.05, 0.45), "every": one_of(2, 3, 4)},
                weight=0.5,
            ),
        ],
    ),
    fault_kind(
        "emergency",
        "The operator presses the emergency stop; only in virtual time.",
        rows=[FaultRow("emergency stop", "emergency stop", at_once=True)],
        begin=lambda f, p: p.press_stop(),
    ),
    fault_kind(
        "second_run",
        "A second run opens the port.",
        rows=[FaultRow("second run", NOTHING, at_once=True, weight=0.5)],
        begin=lambda f, p: p.run_again(),
    ),
)
