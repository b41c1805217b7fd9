"""The lab's wires in memory, in virtual time: UDP, a serial port, and the clock of both ends.

A `Network` carries datagrams between our NatNet client and the emulated Motive, a `MemoryPort` is
the emulated module's end of a serial port and a `MemorySerial` ours. What travels is what travels
on real wires, byte for byte.
"""

import contextlib
import itertools
import socket
from collections import deque
from pathlib import Path
from typing import ClassVar
from unittest import mock

from tetractl.core.clock import SECOND, VirtualClock, wait_for
from tetractl.core.errors import AbortError
from tetractl.emulate.loop import Loop
from tetractl.lab.cameras.optitrack.camera import OptitrackCamera
from tetractl.lab.cameras.optitrack.section import OptitrackSection
from tetractl.lab.inner_loop import IDLE_S, InnerLoop
from tetractl.lab.serial_port import PortHeldError

STEP_NS = SECOND // 1000
PATIENCE_S = 10.0
HOST_CLOCKS = (
    "tetractl.core.clock",
    "tetractl.experiment.lab_section",
    "tetractl.lab.actuators.m3pi.calibrate",
    "tetractl.lab.actuators.m3pi.stop_sequence",
    "tetractl.plant.lab_plant",
)


class LabClock(VirtualClock):
    """Virtual time in steps of a millisecond or else: the timeline first, then each of `steps`."""

    def __init__(self, step_ns=None):
        super().__init__()
        self._step_ns = step_ns
        self.timeline = None
        self.steps = []

    def sleep_until(self, when):
        while self._now < when:
            self._now = min(when, self._now + (self._step_ns or STEP_NS))
            if self.timeline is not None:
                self.timeline.run_to(self._now)
            for step in list(self.steps):
                step()

    def wait(self, condition, patience_s=PATIENCE_S):
        """Let time pass until a condition holds; return whether it does."""
        return wait_for(self, condition, patience_s)


class TrialClock:
    """A clock that starts at 0 when it is made, as a trial's does; `base` goes on below it."""

    def __init__(self, base):
        self._base, self._start = base, base.now()

    def now(self):
        return self._base.now() - self._start

    def sleep_until(self, when):
        self._base.sleep_until(self._start + when)


class VirtualLoop(Loop):
    """The emulator's loop without waiting: `poll` reads what came on its wires."""

    now = staticmethod(lambda: 0)

    def catch_up(self):
        pass

    def poll(self):
        for act in list(self._readers.values()):
            act()


class Network:
    """Datagrams between sockets of this process; nothing is lost or late."""

    def __init__(self):
        self.sockets = {}
        self._ports = itertools.count(40_000)

    def free_port(self):
        return next(self._ports)

    def bound(self, address, port):
        opened = MemorySocket(self)
        opened.bind((address, port))
        return opened


class SocketModule:
    """The standard library's `socket`, but for the sockets."""

    def __init__(self, network):
        self._network = network

    def socket(self, *_):
        return MemorySocket(self._network)

    def __getattr__(self, name):
        return getattr(socket, name)


class MemorySocket:
    """As much of a UDP socket as the lab's code uses."""

    def __init__(self, network):
        self._network, self._queue = network, deque()
        self._name = ("", 0)

    def bind(self, address):
        host, port = address
        self._name = (host, port or self._network.free_port())
        self._network.sockets[self._name] = self

    def sendto(self, data, to):
        receiver = self._network.sockets.get(tuple(to))
        if receiver is not None:
            receiver._queue.append((bytes(data), self._name))

    def recvfrom(self, size):
        if not self._queue:
            raise BlockingIOError
        data, sender = self._queue.popleft()
        return data[:size], sender

    def getsockname(self):
        return self._name

    def fileno(self):
        return self._name[1]

    def setsockopt(self, *_):
        pass

    def setblocking(self, _):
        pass

    def close(self):
        self._network.sockets.pop(self._name, None)


class VirtualCamera(OptitrackCamera):
    """Our NatNet client, turned by the clock in the place of its thread."""

    network: Network
    base: LabClock

    def open(self):
        super()._open_sockets()
        self.base.steps.append(self._turn)

    def __exit__(self, *_):
        if self._turn in self.base.steps:
            self.base.steps.remove(self._turn)
        super().__exit__()

    def _turn(self):
        self._chores()
        for each in self._sockets:
            self._read(each)


class MemoryPort:
    """The emulated module's end of a serial port; `fd` is what the emulator's loop knows it by."""

    ports: ClassVar[dict] = {}

    def __init__(self, link: Path) -> None:
        self.link, self.fd = link, -1
        self.near = None
        self.written = lambda: None  # is called after every write from the other side
        self._stalled = False
        self._written = b""

    def plug(self):
        self.fd = 3
        self.ports[str(self.link)] = self

    def unplug(self):
        self.fd = -1
        self.ports.pop(str(self.link), None)
        if self.near is not None:
            self.near.gone()

    def stall(self, stalled):
        self._stalled = stalled

    def baud(self):
        return self.near.bits_a_second if self.near else 0

    def read(self):
        data, self._written = self._written, b""
        return data

    def write(self, data):
        if self.fd >= 0 and self.near is not None:
            self.near.came(data)

    def take(self, data):
        if self._stalled:
            raise TimeoutError
        self._written += data
        self.written()


class MemorySerial:
    """Our end of the port: what `SerialPort` promises, without a thread."""

    def __init__(self, name, baud, device, clock, heard, hint):
        self.failure = None
        self.bits_a_second = baud
        self._name, self._device, self._hint = name, device, hint
        self._clock, self._heard = clock, heard
        self._port = None

    @staticmethod
    def require(name, device):
        if str(name) not in MemoryPort.ports:
            raise AbortError(f"{name}: there is no such port")

    def open(self, alone=True):
        self.require(self._name, self._device)
        self._port = MemoryPort.ports[str(self._name)]
        if self._port.near is not None and alone:
            raise PortHeldError(str(self._name))
        self._port.near = self

    def write(self, data):
        if self.failure or self._port is None:
            raise AbortError(self.failure or f"the port {self._name} is not open", self._hint)
        try:
            self._port.take(data)
        except TimeoutError:
            raise self._fail(f"takes no more bytes: {self._device} is stuck") from None
        return self._clock.now()

    def set_baud(self, baud):
        self.bits_a_second = baud

    def close(self):
        if self._port is not None:
            self._port.near = None
        self._port = None

    def came(self, data):
        self._heard(data, self._clock.now())

    def gone(self):
        self._fail("is gone: Input/output error")
        self._heard(b"", self._clock.now())

    def _fail(self, what):
        self.failure = self.failure or f"the port {self._name} of {self._device} {what}"
        return AbortError(self.failure, self._hint)


@contextlib.contextmanager
def virtual_wires(network, clock):
    """Let the lab's code in this process find these wires and this clock in place of the host's."""
    VirtualCamera.network, VirtualCamera.base = network, clock
    MemoryPort.ports.clear()

    turns = {}

    def start(loop):
        due = 0

        def turn():  # as its thread does: at each frame, else every IDLE_S
            nonlocal due
            if loop._wake.is_set() or clock.now() >= due:
                loop._wake.clear()
                due = clock.now() + round(IDLE_S * SECOND)
                loop.step()

        turns[id(loop)] = turn
        clock.steps.append(turn)

    def close(loop):
        if id(loop) in turns:
            clock.steps.remove(turns.pop(id(loop)))

    with contextlib.ExitStack() as stack:
        for name, value in (
            *((f"{module}.MonotonicClock", lambda: TrialClock(clock)) for module in HOST_CLOCKS),
            ("tetractl.lab.cameras.optitrack.camera.socket", SocketModule(network)),
            ("tetractl.emulate.optitrack.motive._bound", network.bound),
            ("tetractl.emulate.m3pi.side.PseudoPort", MemoryPort),
            ("tetractl.emulate.field.PseudoPort", MemoryPort),
            ("tetractl.lab.actuators.xbee.link.SerialPort", MemorySerial),
            ("tetractl.lab.actuators.field.driver.SerialPort", MemorySerial),
            ("tetractl.lab.serial_port.require_port", MemorySerial.require),
        ):
            stack.enter_context(mock.patch(name, value))
        device = f"{__name__}:VirtualCamera"
        stack.enter_context(mock.patch.object(OptitrackSection, "device", device))
        stack.enter_context(mock.patch.object(InnerLoop, "start", start))
        stack.enter_context(mock.patch.object(InnerLoop, "close", close))
        yield
