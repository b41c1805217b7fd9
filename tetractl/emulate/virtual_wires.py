"""Wires in memory, in virtual time: UDP, serial ports, pictures over HTTP, and the clock of both
ends.

What travels is what travels on real wires, byte for byte; nothing is lost or late.
"""

import itertools
import threading
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from tetractl.core.clock import SECOND, Clock, VirtualClock
from tetractl.core.errors import AbortError
from tetractl.core.poses import Grey
from tetractl.emulate.loop import Loop, Timeline
from tetractl.emulate.port import PseudoPort
from tetractl.emulate.wires import Wires
from tetractl.lab.cameras.pictures.feed import Picture
from tetractl.lab.cameras.pictures.multipart import Multipart
from tetractl.lab.serial_port import Heard, PortHeldError, SerialPort

STEP_NS = SECOND // 1000


class LabClock(VirtualClock):
    """Virtual time in steps of `step_ns`, 1 ms by default: in each step the `timeline` runs first,
    then each function of `steps`.
    """

    def __init__(self, step_ns: int | None = None) -> None:
        super().__init__()
        self._step_ns = step_ns
        self.timeline: Timeline | None = None
        self.steps: list[Callable[[], None]] = []

    def sleep_until(self, when: int) -> None:
        """Let time pass until `when` [ns]."""
        while self._now < when:
            self._now = min(when, self._now + (self._step_ns or STEP_NS))
            if self.timeline is not None:
                self.timeline.run_to(self._now)
            for step in tuple(self.steps):
                step()


class VirtualLoop(Loop):
    """The emulation's loop, which never waits: `poll` is a step of a LabClock."""

    now = staticmethod(lambda: 0)

    def catch_up(self) -> None:
        """Do nothing: the clock runs the timeline."""

    def poll(self) -> None:
        """Read what has come on the emulation's wires."""
        for act in tuple(self._readers.values()):
            act()


class MemoryWires(Wires):
    """Wires in memory between an emulated lab and our side, both on `clock`."""

    def __init__(self, clock: LabClock) -> None:
        self._clock = clock
        self.sockets: dict[tuple[str, int], MemorySocket] = {}
        self.plugged: dict[str, MemoryPort] = {}
        self._free = itertools.count(40_000)

    def clock(self) -> Clock:
        """Return the one clock."""
        return self._clock

    def each_step(self, turn: Callable[[], None]) -> None:
        """Call `turn` in each step of the clock."""
        self._clock.steps.append(turn)

    def free_port(self) -> int:
        """Return the number of a UDP port that no socket has."""
        return next(self._free)

    def make_socket(self) -> "MemorySocket":
        """Return a UDP socket that is not bound."""
        return MemorySocket(self)

    def bound(self, address: str, port: int) -> "MemorySocket":
        """Return a UDP socket at an address."""
        opened = MemorySocket(self)
        opened.bind((address, port))
        return opened

    def port(self, link: Path) -> "MemoryPort":
        """Return a device's end of a serial port that is opened by the name `link`."""
        return MemoryPort(link, self.plugged)

    def ports(
        self, name: str, baud: int, device: str, clock: Clock, heard: Heard, hint: str
    ) -> "MemorySerial":
        """Return our end of a serial port."""
        return MemorySerial(self.plugged, name, baud, device, clock, heard, hint)

    def network_camera(self, *args: Any, **settings: Any) -> "MemoryNetworkCamera":
        """Return a network camera whose turn is a step of the clock."""
        return MemoryNetworkCamera(*args, **settings)


class MemorySocket:
    """As much of a UDP socket as the lab's code uses."""

    def __init__(self, wires: MemoryWires) -> None:
        self._wires, self._name = wires, ("", 0)
        self._queue = deque[tuple[bytes, tuple[str, int]]]()

    def bind(self, address: tuple[str, int]) -> None:
        host, port = address
        self._name = (host, port or self._wires.free_port())
        self._wires.sockets[self._name] = self

    def sendto(self, data: bytes, to: Sequence[Any]) -> None:
        sockets = self._wires.sockets
        receiver = sockets.get((to[0], to[1])) or sockets.get(("", to[1]))
        if receiver is not None:
            receiver._queue.append((bytes(data), self._name))

    def recvfrom(self, size: int) -> tuple[bytes, tuple[str, int]]:
        if not self._queue:
            raise BlockingIOError
        data, sender = self._queue.popleft()
        return data[:size], sender

    def getsockname(self) -> tuple[str, int]:
        return self._name

    def fileno(self) -> int:
        return self._name[1]

    def setsockopt(self, *_: Any) -> None:
        pass

    def setblocking(self, _: bool) -> None:
        pass

    def close(self) -> None:
        self._wires.sockets.pop(self._name, None)


class MemoryPort(PseudoPort):
    """A device's end of a serial port; `near` is ours, `written` is called when it has written."""

    def __init__(self, link: Path, plugged: "dict[str, MemoryPort]") -> None:
        super().__init__(link)
        self.near: MemorySerial | None = None
        self.written: Callable[[], None] = lambda: None
        self._plugged, self._stalled, self._taken = plugged, False, b""

    def plug(self) -> None:
        self.fd = 3
        self._plugged[str(self.link)] = self

    def unplug(self) -> None:
        self.fd = -1
        self._plugged.pop(str(self.link), None)
        if self.near is not None:
            self.near.gone()

    def stall(self, stalled: bool) -> None:
        self._stalled = stalled

    def baud(self) -> int:
        return self.near.bits_a_second if self.near else 0

    def read(self) -> bytes:
        data, self._taken = self._taken, b""
        return data

    def write(self, data: bytes) -> None:
        if self.fd >= 0 and self.near is not None:
            self.near.came(data)

    def take(self, data: bytes) -> None:
        """Take bytes from our end; TimeoutError while stalled."""
        if self._stalled:
            raise TimeoutError
        self._taken += data
        self.written()


class MemorySerial(SerialPort):
    """Our end of a serial port, without a thread."""

    def __init__(self, plugged: dict[str, MemoryPort], name: str, baud: int, *rest: Any) -> None:
        super().__init__(name, baud, *rest)
        self._plugged, self.bits_a_second = plugged, baud
        self._far: MemoryPort | None = None

    def open(self, alone: bool = True) -> None:
        far = self._plugged.get(str(self._name))
        if far is None:
            raise AbortError(f"{self._name}: there is no such port")
        if far.near is not None and alone:
            raise PortHeldError(str(self._name))
        self._far, far.near = far, self

    def write(self, data: bytes) -> int:
        if self.failure or self._far is None:
            raise AbortError(self.failure or f"the port {self._name} is not open", self._hint)
        try:
            self._far.take(data)
        except TimeoutError:
            raise self._fail(f"takes no more bytes: {self._device} is stuck") from None
        return self._clock.now()

    def set_baud(self, baud: int) -> None:
        self.bits_a_second = baud

    def close(self) -> None:
        if self._far is not None:
            self._far.near = None
        self._far = None

    def came(self, data: bytes) -> None:
        """Receive bytes from the device."""
        self._heard(data, self._clock.now())

    def gone(self) -> None:
        """Fail, since the device was unplugged."""
        self._fail("is gone: Input/output error")
        self._heard(b"", self._clock.now())


class MemoryNetworkCamera:
    """A network camera without threads and sockets, and the `Feed` of the program that watches it.

    Pictures travel as JPEG parts, as over HTTP. The arguments and `url`, `mangle`, `frozen` and
    `every` are those of EmulatedNetworkCamera.
    """

    live = emulated = True
    rate_hz: float | None = None

    def __init__(
        self,
        draw: Callable[[int], Grey],
        clock: LabClock,
        rate_hz: float,
        exposure_s: float,
        latency_s: float,
        quality: int = 90,
        port: int = 0,
        drips: bool = False,
    ) -> None:
        self.url = f"http://127.0.0.1:{port}/"
        self.mangle: Callable[[bytes], bytes] = lambda part: part
        self.frozen, self.every = threading.Event(), 1
        self._draw, self._clock, self._quality = draw, clock, quality
        self._period, self._half = SECOND / rate_hz, round(exposure_s * SECOND / 2)
        self._latency, self._count = round(latency_s * SECOND), 0
        self._sent = deque[tuple[int, bytes]]()
        self._take: Callable[[Picture], None] | None = None

    def __enter__(self) -> "MemoryNetworkCamera":
        self._start = self._clock.now()
        self._clock.steps.append(self._turn)
        return self

    def __exit__(self, *_: object) -> None:
        self._clock.steps.remove(self._turn)

    @property
    def watched(self) -> bool:
        """Whether a program watches the camera."""
        return self._take is not None

    @property
    def damaged(self) -> int:
        """Number of parts that could not be read."""
        return self._parts.damaged

    def join(self, take: Callable[[Picture], None]) -> "MemoryNetworkCamera":
        """Pass each picture to `take` from now on; return the feed."""
        from tetractl.emulate.stream_side import BOUNDARY

        self._take, self._parts = take, Multipart(BOUNDARY)
        return self

    def read(self) -> Picture:
        raise NotImplementedError("pictures are passed on when they arrive")

    def interrupt(self) -> None:
        """End watching."""
        self._take = None

    close = interrupt

    def _turn(self) -> None:
        from tetractl.emulate.stream_side import coded, part

        now, exposed = self._clock.now(), self._start + round(self._count * self._period)
        if now >= exposed + self._half:
            self._count += 1
            if self.watched and not self.frozen.is_set() and self._count % self.every == 0:
                jpeg = coded(self._draw(exposed), self._quality)
                self._sent.append((exposed + self._latency, jpeg))
        while self._sent and self._sent[0][0] <= now:
            body = self.mangle(part(self._sent.popleft()[1]))
            for content in self._parts.feed(body) if self._take else ():
                self._take(Picture(content, now))
