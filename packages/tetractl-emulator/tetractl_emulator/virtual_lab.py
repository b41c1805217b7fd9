"""Runs an emulated lab and the program that drives it in one process, in turn, on one clock.

    clock = LabClock()
    emulation = started(lab, setup, clock, options)    its devices are plugged in
    ports = emulation.wires.ports                      what our camera and actuator are built with
    clock.sleep_until(SECOND)                          a second passes, for the lab and for us

Time passes only while somebody sleeps on the clock, so that a busy computer changes nothing; a
`LiveClock` does the same in real time. *Our side* is the program: guard, inner loop, devices.
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
from tetractl_emulator.process import AFTER_NS, ThisProcess
from tetractl_emulator.script import NOTHING, Script
from tetractl_emulator.sides import EmulatedCamera, Options
from tetractl_emulator.wires import Wires


class LabClock(VirtualClock):
    """Virtual time in steps of `step_ns`, in which an emulated lab and our side run in turn.

    A step calls, in this order,

    1. the emulation that `carry` has named: its events up to now, and `read_wires`, by which it
       reads what our side has sent,
    2. of our side `receivers`, which read sockets, and `steps`, such as the inner loop's,
    3. `watchers`, which only look, and are also called after each action of our side.

    While our process stands still by a fault, only the emulation's events go on.
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

    def carry(
        self,
        timeline: Timeline,
        read_wires: Callable[[], None] | None = None,
        acting: ActingFaults | None = None,
    ) -> None:
        """Move an emulation from another clock to this one.

        Args:
            timeline: The events of the emulation.
            read_wires: Lets both ends of the wires read. None if there is nothing to read.
            acting: The faults that act now. None if there are none.
        """
        self._timeline = timeline
        self._read_wires = read_wires or _read_nothing
        self.acting = acting or ActingFaults()

    def now(self) -> int:
        """Return the time on the host's clock [ns], which a fault may have set forward."""
        return self._now + round(self.acting.total_by("host_clock") * SECOND)

    @property
    def stopped(self) -> bool:
        """Whether the process stands still."""
        return bool(self.acting.of_kind("stopped"))

    @property
    def true_ns(self) -> int:
        """The true time [ns], which no fault of the host sets."""
        return self._now

    def sleep_until(self, when: int) -> None:
        """Let time pass until `when` [ns] on the host's clock, and while the process is stopped."""
        while self.stopped or self.now() < when:
            passed = self._step_ns if self.stopped else min(self._step_ns, when - self.now())
            self._step_to(self._now + passed)

    def _step_to(self, true_ns: int) -> None:
        self._now = true_ns
        if self._timeline is not None:
            self._timeline.run_to(true_ns)
        if self.stopped:
            return
        self._read_wires()
        for act in (*self.receivers, *self.steps):
            act()
        self.watch()

    def watch(self) -> None:
        """Let the watchers look: what an action has changed may end within the same step."""
        for look in self.watchers:
            look()


def _read_nothing() -> None:
    """Read no wires: no emulation has any."""


class LiveClock(LabClock):
    """A `LabClock` in this computer's time.

    A thread makes a step each millisecond, from `start` until the function that it returns is
    called.
    """

    def __init__(self) -> None:
        super().__init__()
        self._host = MonotonicClock()

    def now(self) -> int:
        """Return the time on the host's clock [ns]."""
        return self._host.now()

    def sleep_until(self, when: int) -> None:
        """Wait until `when` [ns]."""
        self._host.sleep_until(when)

    def start(self) -> Callable[[], None]:
        """Begin to make steps; return what ends it."""
        ended = threading.Event()

        def run() -> None:
            while not ended.wait(self._step_ns / SECOND):
                self._step_to(self._host.now())

        thread = threading.Thread(target=run, name="emulated half", daemon=True)
        thread.start()

        def end() -> None:
            ended.set()
            thread.join(2.0)

        return end


class VirtualLoop(Loop):
    """The emulation's loop on a LabClock, which runs the timeline and calls `poll` in each step."""

    now = staticmethod(lambda: 0)

    def catch_up(self) -> None:
        """Do nothing, since the clock runs the timeline."""

    def poll(self) -> None:
        """Read what has come on the emulation's wires."""
        for act in tuple(self._readers.values()):
            act()


def started(
    lab: LabSection,
    setup: Setup,
    clock: LabClock,
    options: Options,
    script: Script = NOTHING,
    supervision: LabSupervision | None = None,
    blind: EmulatedCamera | None = None,
) -> EmulatedLab:
    """Create an emulated lab that runs on a clock.

    It has the faults of this process and of the trial under `supervision`. Only a record has to be
    released.

    Args:
        lab: The section of the lab.
        setup: The constants of the experiment.
        clock: The clock.
        options: Options of the emulation.
        script: The script of faults.
        supervision: How people supervise the trial. None if nobody does.
        blind: The camera of a lab whose own camera is real. None otherwise.
    """
    network = MemoryNetwork()

    emulation = EmulatedLab(
        lab,
        setup,
        script,
        options,
        make_loop=VirtualLoop,
        wires=memory_wires(network, clock),
        process_of=partial(
            ThisProcess,
            clock=clock,
            ports=network.serial,
            supervision=supervision or LabSupervision(),
            outlive=outlive,
        ),
        blind=blind,
    )
    emulation.open()
    clock.carry(emulation.timeline, _loop_of(emulation).poll, emulation.injector.acting)
    return emulation


def outlive(emulation: EmulatedLab) -> None:
    """Let an emulated lab go on for a moment after our side has ended, and close it."""
    _loop_of(emulation).poll()
    emulation.timeline.run_to(emulation.timeline.now_ns + AFTER_NS)
    emulation.close()


def _loop_of(emulation: EmulatedLab) -> VirtualLoop:
    assert isinstance(emulation.loop, VirtualLoop), "`started` has made it"
    return emulation.loop


def memory_wires(network: MemoryNetwork, clock: LabClock) -> Wires:
    """Return the wires of a network in memory.

    Sockets of our side are read in each step of a clock.
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
