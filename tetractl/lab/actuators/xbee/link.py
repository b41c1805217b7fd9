"""A connection to the PC's XBee module through a serial port."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from tetractl.core.clock import Clock, wait_for
from tetractl.core.worker import drained
from tetractl.lab.actuators.xbee import hardware
from tetractl.lab.actuators.xbee.frames import (
    BROADCAST_16,
    EXPLICIT_RECEIVE,
    AtCommand,
    AtResponse,
    Decoder,
    Other,
    Receive,
    Receive16,
    Receive64,
    Transmit16,
    TransmitStatus,
    XbeeFrame,
    encode,
)
from tetractl.lab.actuators.xbee.hardware import XbeeSection
from tetractl.lab.serial_port import Ports, SerialPort

ANSWER_S = 0.3  # a module at 9600 baud answers within 30 ms
KEPT = 1024
HINT = "the robots stop by their watchdog; plug the module in and start again"


@dataclass(frozen=True, slots=True)
class Received:
    """Bytes received at `t_ns` from the address `source`, which is None in transparent mode."""

    source: int | None
    t_ns: int
    data: bytes


class Link:
    """A connection to the module. Times are ns on `clock`. After a failure, which raises
    AbortError, nothing can be sent any more.

    `questions` are about the module, for the operator to answer. `ports` makes the serial port,
    SerialPort by default.
    """

    def __init__(self, radio: XbeeSection, clock: Clock, ports: Ports | None = None) -> None:
        self.radio = radio
        self.undelivered = 0  # number of unicasts that no module acknowledged
        self.explicit = 0  # number of frames of type 0x91, which are not read
        self.questions: tuple[str, ...] = ()
        self.decoder = Decoder(escaped=radio.mode == "api2")
        self._api = radio.mode != "transparent"
        self._fresh: deque[Received] = deque(maxlen=KEPT)
        self._answers: deque[AtResponse] = deque(maxlen=KEPT)
        self._frame_id = 0
        self._clock = clock
        make = ports or SerialPort
        self._port = make(radio.port, radio.baud, "the radio", clock, self._take, HINT)

    @property
    def failure(self) -> str | None:
        """The reason why nothing can be sent any more; None without a fault."""
        return self._port.failure

    def open(self, checked: bool = True, alone: bool = True) -> None:
        """Open the port, exclusively if `alone`; check the module if `checked`, in API modes
        only.
        """
        self._port.open(alone)
        if checked and self._api:
            self.questions = hardware.check_module(self, self.radio)

    def send(self, data: bytes, address: int = BROADCAST_16) -> int:
        """Send data to the module with this address, or to all; return the time of writing [ns].

        In transparent mode `address` is ignored.
        """
        if not self._api:
            return self._port.write(data)
        acknowledged = address != BROADCAST_16
        frame = Transmit16(self._next_id() if acknowledged else 0, address, 0, data)
        return self._port.write(self.packed(frame))

    def packed(self, frame: XbeeFrame | Other) -> bytes:
        """Pack a frame, escaped if the module's mode needs that."""
        return encode(frame, escaped=self.radio.mode == "api2")

    def ask(self, command: bytes, timeout_s: float = ANSWER_S) -> bytes | None:
        """Request a parameter of the module; return its value, None if it gives none in time."""
        wanted = self._next_id()
        self._answers.clear()
        self._port.write(self.packed(AtCommand(wanted, command)))

        def answer() -> AtResponse | None:
            asked = (wanted, command)
            return next((a for a in self._answers if (a.frame_id, a.command) == asked), None)

        self._wait(lambda: answer() is not None, timeout_s)
        found = answer()
        return found.data if found is not None and found.status == 0 else None

    def set_baud(self, baud: int) -> None:
        """Change the baud rate of this side of the port."""
        self._port.set_baud(baud)

    def problems(self) -> tuple[str, ...]:
        """Return one line of text for each reason why data from other modules could not be read."""
        if not self.explicit:
            return ()
        return (
            f"{self.radio.port}: the module reports received data in frames of type 0x91, which "
            "are not read: set its AO to 0 or 2",
        )

    def fetch(self) -> list[Received]:
        """Return the data received from other modules since the last call."""
        return drained(self._fresh)

    def wait(self, timeout_s: float) -> None:
        """Wait at most `timeout_s` until data from other modules can be fetched."""
        self._wait(lambda: bool(self._fresh), timeout_s)

    def close(self) -> None:
        """End the reading thread and release the port; may be called twice, never raises."""
        self._port.close()

    def _wait(self, done: Callable[[], bool], timeout_s: float) -> None:
        wait_for(self._clock, lambda: done() or self.failure is not None, timeout_s)

    def _next_id(self) -> int:
        self._frame_id = self._frame_id % 255 + 1
        return self._frame_id

    def _take(self, data: bytes, now: int) -> None:
        if not self._api and data:
            self._fresh.append(Received(None, now, data))
        elif data:
            for frame in self.decoder.feed(data):
                self._sort(frame, now)

    def _sort(self, frame: XbeeFrame | Other, now: int) -> None:
        match frame:
            case AtResponse():
                self._answers.append(frame)
            case Receive16(source, _, _, data) | Receive64(source, _, _, data):
                self._fresh.append(Received(source, now, data))
            case Receive(_, short, _, data):
                self._fresh.append(Received(short, now, data))
            case Other(api) if api == EXPLICIT_RECEIVE:
                self.explicit += 1
            case TransmitStatus(_, status) if status:
                self.undelivered += 1
            case _:
                pass
