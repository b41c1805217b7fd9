"""The serial port with an XBee module behind it.

Writing never waits: a port that takes nothing for 20 ms is stuck and raises, one that is gone
raises at once. Reading is a thread's work; what it finds is fetched with `fetch`.
"""

import os
import select
import threading
from collections import deque
from contextlib import suppress
from dataclasses import dataclass

import serial

from tetractl.core.clock import Clock
from tetractl.core.errors import AbortError
from tetractl.core.wire_tap import NO_TAP, Tap
from tetractl.lab.actuators.xbee import check
from tetractl.lab.actuators.xbee.frames import (
    BROADCAST_16,
    AtCommand,
    AtResponse,
    Other,
    Receive,
    Receive16,
    Receive64,
    Transmit16,
    TransmitStatus,
    XbeeFrame,
)
from tetractl.lab.actuators.xbee.framing import Decoder, encode
from tetractl.lab.actuators.xbee.section import XbeeSection

WRITE_TIMEOUT_S = 0.02
READ_TIMEOUT_S = 0.05
ANSWER_S = 0.3  # a module at 9600 baud answers within 30 ms
NO_ACK = 0x01  # transmit option: do not wait for the receiver's acknowledgement
KEPT = 1024
MAX_BUFFER = 2048  # bytes the system may still have to send before the port counts as stuck


@dataclass(frozen=True, slots=True)
class Received:
    """Bytes from another module: its address, None where the mode does not tell, and when [ns]."""

    source: int | None
    t_ns: int
    data: bytes


@dataclass(slots=True)
class LinkCounts:
    """What passed; every number only grows."""

    frames_sent: int = 0
    received: int = 0
    undelivered: int = 0  # unicasts that no module acknowledged


class Link:
    """An open port. Times are ns on `clock`; every failure is an AbortError and final."""

    def __init__(self, radio: XbeeSection, clock: Clock, tap: Tap = NO_TAP) -> None:
        self.radio = radio
        self.counts = LinkCounts()
        self.failure: str | None = None
        self.decoder = Decoder(escaped=radio.mode == "api2")
        self._clock, self._tap = clock, tap
        self._api = radio.mode != "transparent"
        self._sending = threading.Lock()
        self._fresh: deque[Received] = deque(maxlen=KEPT)
        self._answers: deque[AtResponse] = deque(maxlen=KEPT)
        self._came = threading.Condition()
        self._closing = threading.Event()
        self._frame_id = 0
        self._port: serial.Serial | None = None
        self._thread = threading.Thread(target=self._receive, name="radio", daemon=True)

    def open(self, checked: bool = True) -> None:
        """Open the port for this process alone and, `checked` in an API mode, check the module."""
        radio = self.radio
        try:
            self._port = serial.Serial(
                radio.port,
                radio.baud,
                timeout=READ_TIMEOUT_S,
                write_timeout=WRITE_TIMEOUT_S,
                exclusive=True,
            )
        except (serial.SerialException, OSError, ValueError) as error:
            raise _cannot_open(radio.port, error) from error
        self._thread.start()
        if checked and self._api:
            check.module(self, radio)

    def send(self, data: bytes, address: int = BROADCAST_16) -> int:
        """Send to one module or to all; return when the bytes were handed over [ns]."""
        if not self._api:
            return self._write(data)
        acknowledged = address != BROADCAST_16
        frame = Transmit16(self._next_id() if acknowledged else 0, address, 0, data)
        return self._write(self.packed(frame))

    def packed(self, frame: XbeeFrame | Other) -> bytes:
        """Pack a frame as the module's mode wants it."""
        return encode(frame, escaped=self.radio.mode == "api2")

    def ask(self, command: bytes, timeout_s: float = ANSWER_S) -> bytes | None:
        """Ask the module for a parameter; return its value, None without an answer."""
        wanted = self._next_id()
        self._answers.clear()
        self._write(self.packed(AtCommand(wanted, command)))

        def answer() -> AtResponse | None:
            return next((a for a in self._answers if a.frame_id == wanted), None)

        with self._came:
            self._came.wait_for(lambda: answer() is not None or self.failure, timeout_s)
        found = answer()
        return found.data if found is not None and found.status == 0 else None

    def set_baud(self, baud: int) -> None:
        """Speak at another rate."""
        assert self._port is not None
        self._port.baudrate = baud

    def fetch(self) -> list[Received]:
        """Return, once, what other modules sent since the last call."""
        fresh: list[Received] = []
        while self._fresh:
            fresh.append(self._fresh.popleft())
        return fresh

    def wait(self, timeout_s: float) -> None:
        """Wait until something came, at most `timeout_s`."""
        with self._came:
            self._came.wait_for(lambda: bool(self._fresh) or self.failure, timeout_s)

    def close(self) -> None:
        """End the thread and give the port back; idempotent, never raises."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join(2.0)
        if self._port is not None:
            with suppress(OSError, serial.SerialException):
                self._port.close()

    def _next_id(self) -> int:
        self._frame_id = self._frame_id % 255 + 1
        return self._frame_id

    def _write(self, data: bytes) -> int:
        with self._sending:
            if self.failure or self._port is None:
                raise AbortError(self.failure or f"the radio on {self.radio.port} is not open")
            try:
                _put(self._port.fileno(), data)
                waiting = self._port.out_waiting
            except TimeoutError:
                raise self._failed("takes no more bytes: the radio is stuck") from None
            except (serial.SerialException, OSError, TypeError) as error:
                raise self._failed(f"is gone: {_why(error)}") from error
            if waiting > MAX_BUFFER:
                raise self._failed(f"holds {waiting} bytes back: the radio is stuck")
            now = self._clock.now()
            self.counts.frames_sent += 1
        self._tap.sent("radio", now, data)
        return now

    def _failed(self, what: str) -> AbortError:
        self.failure = self.failure or f"the radio's port {self.radio.port} {what}"
        return AbortError(
            self.failure, "the robots stop by their watchdog; plug it in, start again"
        )

    def _receive(self) -> None:
        port = self._port
        assert port is not None
        while not self._closing.is_set():
            try:
                data = port.read(1)
                if data:
                    data += port.read(port.in_waiting)
            except (serial.SerialException, OSError, TypeError, ValueError) as error:
                if not self._closing.is_set():
                    self._failed(f"is gone: {_why(error)}")
                    with self._came:
                        self._came.notify_all()
                return
            if data:
                self._take(data)

    def _take(self, data: bytes) -> None:
        now = self._clock.now()
        self._tap.received("radio", now, data)
        if not self._api:
            self._fresh.append(Received(None, now, data))
            self.counts.received += 1
        else:
            for frame in self.decoder.feed(data):
                self._sort(frame, now)
        with self._came:
            self._came.notify_all()

    def _sort(self, frame: XbeeFrame | Other, now: int) -> None:
        match frame:
            case AtResponse():
                self._answers.append(frame)
            case Receive16(source, _, _, data) | Receive64(source, _, _, data):
                self._fresh.append(Received(source, now, data))
                self.counts.received += 1
            case Receive(_, short, _, data):
                self._fresh.append(Received(short, now, data))
                self.counts.received += 1
            case TransmitStatus(_, status) if status:
                self.counts.undelivered += 1
            case _:
                pass


def _put(fd: int, data: bytes) -> None:
    """Hand bytes to the system; TimeoutError where it takes none for 20 ms.

    pyserial's own write also times out where this process was merely not scheduled for that long.
    """
    rest = memoryview(data)
    while rest:
        with suppress(BlockingIOError):
            rest = rest[os.write(fd, rest) :]
        if rest and not select.select([], [fd], [], WRITE_TIMEOUT_S)[1]:
            raise TimeoutError


def _why(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


def _cannot_open(port: str, error: Exception) -> AbortError:
    number = getattr(error, "errno", None)
    text = str(error)
    if number == 11 or "exclusively lock" in text:
        return AbortError(
            f"{port}: another program has this port open",
            "one run at a time; end the other, or `tetractl lab stop` if it left robots moving",
        )
    if number == 2 or "No such file" in text:
        return AbortError(f"{port}: there is no such port", "is the radio plugged in?")
    if number == 13:
        return AbortError(
            f"{port}: this user may not open it", "join the group that owns it, often dialout"
        )
    return AbortError(f"{port}: cannot be opened: {_why(error)}")
