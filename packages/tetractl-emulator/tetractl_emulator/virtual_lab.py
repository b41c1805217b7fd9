"""Runs an emulated lab and the program that drives it in one process, on a shared virtual clock.

    clock = LabClock()
    emulation = start_emulated_lab(lab, setup, clock, options)
    ports = emulation.wires.ports                      for creating our camera and actuator
    clock.sleep_until(SECOND)                          a second passes, for both

Time passes only while the program sleeps on the clock, so a busy computer does not change the
result. A `LiveClock` does the same in real time. In this module, *our side* is the program: its
guard, inner loop and devices.
"""

import threading
from collections.abc import Callable
from functools import partial

from tetractl.core.clock import MILLISECOND, SECOND, MonotonicClock, VirtualClock
from tetractl.core.protocols import LabSupervision
from tetractl.core.setup import Setup
from tetractl.spec.lab_section import LabSection
from tetractl_emulator.emulated_lab import EmulatedLab
from tetractl_emulator.faults import ActingFaults
from tetractl_emulator.loop import Loop, Timeline
from tetractl_emulator.memory_wires import MemoryNetwork, MemorySocket
from tetractl_emulator.process import CONTINUE_NS, ThisProcess
from tetractl_emulator.script import NO_FAULTS, Script
from tetractl_emulator.sides import EmulatedCamera, Options
from tetractl_emulator.wires import Wires


class LabClock(VirtualClock):
    """A virtual clock on which an emulated lab and our side run in turn.

    Each step of `step_ns` calls, in this order:

    1. the emulation that `set_emulation` has set: its events up to now, and `read_wires`, with
       which the emulation reads what our side has sent,
    2. on our side, the functions in `receivers`, which read sockets, and in `steps`, such as the
       steps of the inner loop,
    3. the functions in `watchers`, which only observe. They are also called after each action of
       our side.

    While a fault suspends our process, only the emulation continues.

    Attributes:
        acting: The faults of the emulation that act now.
        receivers: Functions of our side that read sockets.
        steps: Functions of our side that act.
        watchers: Functions that observe.
    """

    def __init__(self, step_ns: int = MILLISECOND) -> None:
        super().__init__()
        self._step_ns = step_ns
        self._timeline: Timeline | None = None
        self._read_wires: Callable[[], None] = _read_nothing
        self.acting = ActingFaults()
        """The faults of the emulation that act now."""
        self.receivers: list[Callable[[], None]] = []
        self.steps: list[Callable[[], None]] = []
        self.watchers: list[Callable[[], None]] = []

    def set_emulation(
        self,
        timeline: Timeline,
        read_wires: Callable[[], None] | None = None,
        acting: ActingFaults | None = None,
    ) -> None:
        """Set the emulation that runs on this clock. It replaces an earlier emulation.

        Args:
            timeline: The events of the emulation.
            read_wires: Lets both ends of the connections read. None if there are no connections.
            acting: The faults that act now. None if there are none.
        """
        self._timeline = timeline
        self._read_wires = read_wires or _read_nothing
        self.acting = acting or ActingFaults()

    def now(self) -> int:
        """Return the time on the host's clock [ns]. A fault may have set this clock forward."""
        return self._now + round(self.acting.total_by("host_clock") * SECOND)

    @property
    def is_suspended(self) -> bool:
        """Whether a fault has suspended our process at this moment."""
        return bool(self.acting.of_kind("stopped"))

    @property
    def true_ns(self) -> int:
        """The true time [ns], which no fault changes."""
        return self._now

    def sleep_until(self, when: int) -> None:
        """Let time pass until `when` [ns] on the host's clock.

        If a fault suspends our process at that time, the method returns when the process resumes.
        """
        while self.is_suspended or self.now() < when:
            step_ns = self._step_ns if self.is_suspended else min(self._step_ns, when - self.now())
            self._step_to(self._now + step_ns)

    def _step_to(self, true_ns: int) -> None:
        """Advance to a true time [ns], and call the functions of one step.

        While a fault suspends our process, only the emulation advances.
        """
        self._now = true_ns
        if self._timeline is not None:
            self._timeline.run_to(true_ns)
        if self.is_suspended:
            return
        self._read_wires()
        for run_step in (*self.receivers, *self.steps):
            run_step()
        self.watch()

    def watch(self) -> None:
        """Call the watchers now, because the effects of an action may end within this step."""
        for call_watcher in self.watchers:
            call_watcher()


def _read_nothing() -> None:
    """Do nothing, for an emulation without connections."""


class LiveClock(LabClock):
    """A `LabClock` in real time: a thread performs a step every millisecond."""

    def __init__(self) -> None:
        super().__init__()
        self._host = MonotonicClock()

    def now(self) -> int:
        """Return the time on the host's monotonic clock [ns]."""
        return self._host.now()

    def sleep_until(self, when: int) -> None:
        """Wait until the time `when` [ns]. Return at once if it has passed."""
        self._host.sleep_until(when)

    def start(self) -> Callable[[], None]:
        """Start the thread that performs the steps, and return a function that stops the thread.

        The returned function waits up to two seconds for the thread to end.
        """
        must_stop = threading.Event()

        def run_steps() -> None:
            while not must_stop.wait(self._step_ns / SECOND):
                self._step_to(self._host.now())

        thread = threading.Thread(target=run_steps, name="emulated half", daemon=True)
        thread.start()

        def stop_thread() -> None:
            must_stop.set()
            thread.join(2.0)

        return stop_thread


class VirtualLoop(Loop):
    """The emulation's event loop on a `LabClock`.

    The clock runs the timeline and calls `poll` in each step.
    """

    now = staticmethod(lambda: 0)

    def catch_up(self) -> None:
        """Do nothing, because the clock runs the timeline."""

    def poll(self) -> None:
        """Read the data that has arrived on the emulation's connections."""
        for read in tuple(self._readers.values()):
            read()


def start_emulated_lab(
    lab: LabSection,
    setup: Setup,
    clock: LabClock,
    options: Options,
    script: Script = NO_FAULTS,
    supervision: LabSupervision | None = None,
    stand_in_camera: EmulatedCamera | None = None,
) -> EmulatedLab:
    """Create an emulated lab, open it, and run it on a clock.

    The connections are in memory. The lab only has to be closed if it writes a record.

    Args:
        lab: The lab's section of the spec.
        setup: The constants of the experiment.
        clock: The clock.
        options: Options of the emulation.
        script: How the lab differs from the spec, and its faults.
        supervision: The supervision of the trial, on which faults such as signals act. None if
            there is no trial.
        stand_in_camera: Stands in for the emulated camera if the camera is real. None to emulate
            the camera.
    """
    network = MemoryNetwork()

    emulation = EmulatedLab(
        lab,
        setup,
        script,
        options,
        make_loop=VirtualLoop,
        wires=create_memory_wires(network, clock),
        process_of=partial(
            ThisProcess,
            clock=clock,
            ports=network.serial,
            supervision=supervision or LabSupervision(),
            continue_and_close=continue_and_close,
        ),
        stand_in_camera=stand_in_camera,
    )
    emulation.open()
    clock.set_emulation(emulation.timeline, _loop_of(emulation).poll, emulation.injector.acting)
    return emulation


def continue_and_close(emulation: EmulatedLab) -> None:
    """Let an emulated lab continue for CONTINUE_NS after our side has ended, then close it."""
    _loop_of(emulation).poll()
    emulation.timeline.run_to(emulation.timeline.now_ns + CONTINUE_NS)
    emulation.close()


def _loop_of(emulation: EmulatedLab) -> VirtualLoop:
    """Return the emulation's loop, which must be a `VirtualLoop`."""
    assert isinstance(emulation.loop, VirtualLoop), "`start_emulated_lab` creates it"
    return emulation.loop


def create_memory_wires(network: MemoryNetwork, clock: LabClock) -> Wires:
    """Create the functions that connect devices and programs through a network in memory.

    Args:
        network: The network.
        clock: The clock whose steps let our sockets read.
    """

    def make_socket(read: Callable[[], None]) -> MemorySocket:
        if read not in clock.receivers:
            clock.receivers.append(read)
        return MemorySocket(network)

    return Wires(
        clock=lambda: clock,
        port=network.port,
        bound=network.bound_socket,
        http=False,
        ports=network.serial,
        make_socket=make_socket,
    )
