"""Wires in memory, in virtual time: UDP, serial ports, the clock of both ends, and an emulated lab.

What travels is what travels on real wires, byte for byte; nothing is lost or late.
"""

import threading
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from tetractl.core.clock import MILLISECOND, SECOND, MonotonicClock, VirtualClock
from tetractl.core.errors import AbortError
from tetractl.core.protocols import LabSupervision
from tetractl.core.setup import Setup
from tetractl.experiment.lab_section import LabSection
from tetractl.lab.serial_port import PortHeldError, SerialPort, missing_port
from tetractl.lab.udp_port import SCHEME
from tetractl_emulator.emulated_lab import EmulatedLab
from tetractl_emulator.faults import ActingFaults
from tetractl_emulator.loop import Loop, Timeline
from tetractl_emulator.port import PseudoPort
from tetractl_emulator.process import AFTER_NS, ThisProcess
from tetractl_emulator.script import NOTHING, Script
from tetractl_emulator.sides import EmulatedCamera, Options
from tetractl_emulator.wires import Wires


class LabClock(VirtualClock):
    """Virtual time in steps of `step_ns`, in which an emulated lab and our side run in turn.

    In each step, in this order: the emulation's `timeline`, and `read_wires`, by which it reads
    what our side has sent; of our side each of `receivers`, which read sockets, and each of
    `steps`; at last each of `watchers`, which also look after each action.
    """

    def __init__(self, step_ns: int = MILLISECOND) -> None:
        super().__init__()
        self._step_ns = step_ns
        self.timeline: Timeline | None = None
        self.read_wires: Callable[[], None] | None = None
        self.receivers: list[Callable[[], None]] = []
        self.steps: list[Callable[[], None]] = []
        self.watchers: list[Callable[[], None]] = []
        self.acting = ActingFaults()  # those of the emulated lab

    def now(self) -> int:
        """Return the time on the host's clock [ns], which a fault may have set forward."""
        return self._now + round(self.acting.total_by("host_clock") * SECOND)

    @property
    def stopped(self) -> bool:
        """Whether the process stands still."""
        return bool(self.acting.of("stopped"))

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
        if self.timeline is not None:
            self.timeline.run_to(self._now)
        if self.stopped:
            return
        if self.read_wires is not None:
            self.read_wires()
        for receive in tuple(self.receivers):
            receive()
        for step in tuple(self.steps):
            step()
        self._watch()

    def note_action(self) -> None:
        """Let the watchers see what an action has changed, which may end within the same step."""
        self._watch()

    def _watch(self) -> None:
        for watcher in self.watchers:
            watcher()


class LiveClock(LabClock):
    """A `LabClock` in this computer's time: a thread makes a step each millisecond, from `start`
    until what it returns is called."""

    def __init__(self) -> None:
        super().__init__()
        self._host = MonotonicClock()

    def now(self) -> int:
        """Return the time on the host's clock [ns]."""
        return self._host.now()

    def sleep_until(self, when: int) -> None:
        """Wait until `when` [ns]."""
        self._host.sleep_until(when)

    def note_action(self) -> None:
        """Do nothing: the watchers look from the thread that makes the steps."""

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
    """The emulation's loop in virtual time; a LabClock calls `poll` in each step."""

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
    """Return an emulated lab that runs on a clock, with the faults of this process, of the trial
    under `supervision`; only a record has to be released.
    """
    wires = memory_wires(clock)
    ports = wires.ports
    assert ports is not None, "wires in memory have ports"
    watched = supervision or LabSupervision()

    def this_process(emulation: EmulatedLab) -> ThisProcess:
        return ThisProcess(emulation, ports, clock, watched, partial(outlive, emulation))

    emulation = EmulatedLab(
        lab,
        setup,
        script,
        options,
        make_loop=VirtualLoop,
        wires=wires,
        process_of=this_process,
        blind=blind,
    )
    emulation.open()
    assert isinstance(emulation.loop, VirtualLoop)
    clock.acting = emulation.injector.acting
    clock.timeline = emulation.timeline
    clock.read_wires = emulation.loop.poll
    return emulation


def outlive(emulation: EmulatedLab) -> None:
    """Let an emulated lab go on for a moment after our side has ended, and close it."""
    assert isinstance(emulation.loop, VirtualLoop)
    emulation.loop.poll()
    emulation.timeline.run_to(emulation.timeline.now_ns + AFTER_NS)
    emulation.close()


def memory_wires(clock: LabClock) -> Wires:
    """Return wires in memory between an emulated lab and our side, both on a clock."""
    network: Network = {}
    plugged: Plugged = {}

    def make_socket(turn: Callable[[], None]) -> MemorySocket:
        if turn not in clock.receivers:
            clock.receivers.append(turn)
        return MemorySocket(network)

    def bound(host: str, port: int) -> MemorySocket:
        opened = MemorySocket(network)
        opened.bind((host, port))
        return opened

    return Wires(
        clock=lambda: clock,
        port=partial(MemoryPort, plugged),
        bound=bound,
        http=False,
        ports=partial(MemorySerial, plugged),
        make_socket=make_socket,
    )


class MemorySocket:
    """A UDP socket of a network in memory; its methods are those of `socket.socket`."""

    def __init__(self, network: "Network") -> None:
        self._network = network
        self._name = ("", 0)
        self._queue = deque[tuple[bytes, tuple[str, int]]]()

    def setsockopt(self, *option: Any) -> None:
        """Do nothing: a network in memory has no options."""

    def setblocking(self, blocking: bool) -> None:
        """Do nothing: `recvfrom` never waits."""

    def getsockname(self) -> tuple[str, int]:
        """Return the address at which the socket listens."""
        return self._name

    def fileno(self) -> int:
        """Return a number that no other socket of the network has: its port."""
        return self._name[1]

    def bind(self, address: tuple[str, int]) -> None:
        """Listen at an address; port 0 is any free port."""
        free = max((port for _, port in self._network), default=0) + 1
        self._name = (address[0], address[1] or max(free, 40_000))
        self._network[self._name] = self

    def sendto(self, data: bytes, to: Sequence[Any]) -> None:
        """Send a datagram to an address, or to a socket that is bound to all addresses."""
        receiver = self._network.get((to[0], to[1])) or self._network.get(("", to[1]))
        if receiver is not None:
            receiver._queue.append((bytes(data), self._name))

    def recvfrom(self, size: int) -> tuple[bytes, tuple[str, int]]:
        """Return the oldest datagram and its sender's address; BlockingIOError if there is none."""
        if not self._queue:
            raise BlockingIOError
        data, sender = self._queue.popleft()
        return data[:size], sender

    def close(self) -> None:
        """Stop listening."""
        self._network.pop(self._name, None)


class MemoryPort(PseudoPort):
    """A device's end of a serial port in memory; `written` is called after a write of ours."""

    def __init__(self, plugged: "Plugged", link: Path | str) -> None:
        super().__init__(link)
        self._network = self.name.startswith(SCHEME)
        self.near: MemorySerial | None = None
        self.written: Callable[[], None] = lambda: None
        self.stalled = False
        self.taken = deque[bytes]()
        self._plugged = plugged

    def plug(self) -> None:
        """Make the port known by its name."""
        self.fd = 1 + max((port.fd for port in self._plugged.values()), default=2)
        self._plugged[self.name] = self

    def unplug(self) -> None:
        """Remove the port; our end fails. May be called twice."""
        self.fd = -1
        self.taken.clear()
        self._plugged.pop(self.name, None)
        if self.near is not None:
            self.near.hear(b"")

    def stall(self, stalled: bool) -> None:
        """Refuse bytes, or accept them again."""
        self.stalled = stalled

    def baud(self) -> int | None:
        """Return the speed that our end has set [bits per second]; 0 if it is closed, None for a
        network."""
        if self._network:
            return None
        return self.near.bits_a_second if self.near else 0

    def read(self) -> bytes:
        """Return the bytes that our end has written, of a network the next datagram."""
        if not self.taken:
            return b""
        if self._network:
            return self.taken.popleft()
        data = bytearray()
        while self.taken:
            data += self.taken.popleft()
        return bytes(data)

    def write(self, data: bytes) -> None:
        """Pass bytes to our end, if it is open."""
        if self.fd >= 0 and self.near is not None:
            self.near.hear(data)


class MemorySerial(SerialPort):
    """Our end of a serial port in memory, without a thread."""

    def __init__(self, plugged: "Plugged", name: str, baud: int, *rest: Any) -> None:
        super().__init__(name, baud, *rest)
        self._plugged = plugged
        self.bits_a_second = baud
        self._far: MemoryPort | None = None

    def open(self, alone: bool = True) -> None:
        """Open the port as SerialPort does."""
        far = self._plugged.get(str(self._name))
        if far is None:
            raise missing_port(self._name, self._device)
        if far.near is not None and alone:
            raise PortHeldError(str(self._name))
        self._far = far
        far.near = self

    def write(self, data: bytes) -> int:
        """Send bytes as SerialPort does; return the time [ns]."""
        if self.failure or self._far is None:
            raise AbortError(self.failure or f"the port {self._name} is not open", self._hint)
        if self._far.stalled:
            raise self._fail(f"takes no more bytes: {self._device} is stuck")
        self._far.taken.append(data)
        self._far.written()
        return self._clock.now()

    def set_baud(self, baud: int) -> None:
        """Change the speed [bits per second]."""
        self.bits_a_second = baud

    def close(self) -> None:
        """Close the port; may be called twice."""
        if self._far is not None:
            self._far.near = None
        self._far = None

    def hear(self, data: bytes) -> None:
        """Receive bytes from the device; fail if there are none, since it was unplugged."""
        if not data:
            self._fail("is gone: Input/output error")
        self._heard(data, self._clock.now())


Network = dict[tuple[str, int], MemorySocket]
Plugged = dict[str, MemoryPort]
