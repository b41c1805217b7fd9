"""Faults of the process that drives the robots: signals, a full disk, a busy host, a second run.

In virtual time, the faults act inside this process: its clock and its plant query them. In real
time, they act on the process that has locked the actuator's port, as far as one process can act on
another.
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
from tetractl.lab.port_holder import find_holder
from tetractl.lab.serial_port import PortFactory, SerialPort
from tetractl.spec.base import Positive
from tetractl_emulator.fault_rows import (
    CELL_REASONS,
    LATE_REASONS,
    MOVED_REASONS,
    NO_REASON,
    FaultRow,
    one_of,
    value_between,
)
from tetractl_emulator.faults import begin_by_switching, fault_kind

CONTINUE_NS = SECOND
"""Time for which an emulated lab continues after the process has ended, so that robots stop [ns].
"""
SIGNALS = Literal["INT", "TERM", "HUP", "QUIT", "KILL"]


class Process:
    """The process that drives the robots of an emulated lab, as a target of faults.

    It is the process that has locked the actuator's port. If no process has locked the port, the
    methods do nothing.

    Args:
        lab: The emulated lab.
        clock: The clock for times.
        ports: Creates a port, to try to open the actuator's port a second time.
    """

    def __init__(self, lab: Any, clock: Clock, ports: PortFactory = SerialPort) -> None:
        self._lab = lab
        self._clock = clock
        self._ports = ports

    def signal(self, name: str) -> None:
        """Send a signal to the process that has locked the port. The name is without "SIG".

        Nothing happens if there is no such process.
        """
        self._act(lambda pid: os.kill(pid, signal.Signals[f"SIG{name}"]))

    def stop(self, is_suspended: bool) -> None:
        """Suspend the process, as SIGSTOP or the computer's sleep would, or let it continue.

        Args:
            is_suspended: True to suspend the process, False to let it continue.
        """
        self._act(lambda pid: os.kill(pid, signal.SIGSTOP if is_suspended else signal.SIGCONT))

    def fill_disk(self) -> None:
        """Make all further writes of the process to files fail.

        Writes fail completely instead of being cut short, because Python 3.11 keeps partly written
        bytecode of a module, and the next process may fail on it.
        """
        self._act(lambda pid: resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, 0)))

    def press_stop(self) -> None:
        """Do nothing, because the emergency-stop key of another process cannot be pressed."""

    def _act(self, act: Callable[[int], object]) -> None:
        """Call a function with the id of the process that has locked the port.

        Nothing happens if there is none, or if the function raises OSError.
        """
        with suppress(OSError):
            if pid := find_holder(self._lab.port):
                act(pid)

    def run_again(self) -> None:
        """Try to open the actuator's port like a second run, and record the error message.

        The message is "" if the port could be opened.
        """
        port_arguments = (self._lab.port, 57600, "the second run", self._clock, lambda *_: None, "")
        second_port = self._ports(*port_arguments)
        message = ""
        try:
            second_port.open()
        except AbortError as error:
            message = error.message
        else:
            second_port.close()
        self._lab.note("second", says=message)


class ThisProcess(Process):
    """This process as a target of faults, in virtual time.

    Args:
        lab: The emulated lab.
        ports: Creates a port, to try to open the actuator's port a second time.
        clock: The virtual clock.
        supervision: The supervision of the trial, through which signals and the key are simulated.
        continue_and_close: Lets the emulated lab continue for a moment without the program, and
            then closes the lab.
    """

    def __init__(
        self,
        lab: Any,
        ports: PortFactory,
        clock: Clock,
        supervision: LabSupervision,
        continue_and_close: Callable[[Any], None],
    ) -> None:
        super().__init__(lab, clock, ports)
        self._supervision = supervision
        self._continue_and_close = continue_and_close

    def signal(self, name: str) -> None:
        """Handle a signal as the trial's signal handler would.

        For KILL, the emulation continues for a moment, and then this process kills itself.
        """
        if name != "KILL":
            self._supervision.signalled()
            return
        self._continue_and_close(self._lab)
        os.kill(os.getpid(), signal.SIGKILL)

    def stop(self, is_suspended: bool) -> None:
        """Do nothing: the clock stops this process while the fault acts."""

    def fill_disk(self) -> None:
        """Make the next write of the log fail with "no space left".

        The disk itself is not filled.
        """
        self._supervision.fail_log(OSError(ENOSPC, os.strerror(ENOSPC)))

    def press_stop(self) -> None:
        """Trigger the emergency stop of our process, as the operator's key would."""
        self._supervision.emergency.set()


STANDSTILL_REASONS = (
    f"stood still|late|{CELL_REASONS}|{LATE_REASONS}"  # cells seem to stand still meanwhile
)
SLEEP_REASONS = f"{STANDSTILL_REASONS}|{MOVED_REASONS}"
PROCESS_FAULTS = (
    fault_kind(
        "signal",
        "The process that drives the robots receives this signal.",
        fields={"signal": SIGNALS},
        rows=[
            FaultRow("killed", NO_REASON, {"signal": "KILL"}, at_once=True),
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
        "The process that drives the robots is suspended, or sleeps.",
        rows=[
            FaultRow("suspended", SLEEP_REASONS, {"for": value_between(0.02, 5)}),
            FaultRow("computer sleeps", SLEEP_REASONS, {"for": one_of(3.0, 30.0)}),
        ],
        begin=begin_by_switching(lambda f, p: p.stop),
    ),
    fault_kind(
        "disk_full",
        "The disk that holds the log is full.",
        rows=[FaultRow("disk full", "cannot write the log", at_once=True)],
        begin=lambda f, p: p.fill_disk(),
    ),
    fault_kind(
        "host_clock",
        "The computer's monotonic clock jumps by this time [s]. Works only in virtual time.",
        fields={"by": Positive},
        rows=[
            FaultRow(
                "host's clock jumps",
                STANDSTILL_REASONS,
                {"by": value_between(0.02, 6)},
                at_once=True,
            )
        ],
    ),
    fault_kind(
        "busy",
        "Each plan, or one plan in `every`, takes this time [s]. Works only in virtual time.",
        fields={"seconds": Positive, "every": (Annotated[int, Field(ge=1)], 1)},
        rows=[
            FaultRow(
                "host busy", f"late|silent|{MOVED_REASONS}", {"seconds": value_between(0.01, 6)}
            ),
            FaultRow(
                "host busy at times",
                f"late|silent|{MOVED_REASONS}",
                {"seconds": value_between(0.05, 0.45), "every": one_of(2, 3, 4)},
                weight=0.5,
            ),
        ],
    ),
    fault_kind(
        "emergency",
        "The operator presses the emergency stop. Works only in virtual time.",
        rows=[FaultRow("emergency stop", "emergency stop", at_once=True)],
        begin=lambda f, p: p.press_stop(),
    ),
    fault_kind(
        "second_run",
        "A second run opens the same port.",
        rows=[FaultRow("second run", NO_REASON, at_once=True, weight=0.5)],
        begin=lambda f, p: p.run_again(),
    ),
)
