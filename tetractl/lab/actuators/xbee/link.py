"""A connection to the PC's XBee module through a serial port."""

from collections import deque
from collections.abc import Callable

from tetractl.core.clock import Clock, wait_for
from tetractl.lab.actuators.xbee import frames, hardware
from tetractl.lab.actuators.xbee.hardware import XbeeSection
from tetractl.lab.serial_port import Ports, SerialPort

ANSWER_S = 0.3  # a module at 9600 baud answers within 30 ms
QUEUED = 1024
HINT = "the robots stop by their watchdog; plug the module in and start again"


class Link:
    """A connection to the module. Times are ns on `clock`. After a failure, which raises
    AbortError, nothing can be sent any more.

    `questions` are about the module, for the operator to answer. `ports` makes the serial port,
    SerialPort by default.
    """

    def __init__(self, radio: XbeeSection, clock: Clock, ports: Ports | None = None) -> None:
        self.radio = radio
        self.questions: tuple[str, ...] = ()
        self._decoder = frames.Decoder()
        self._fresh: deque[bytes] = deque(maxlen=QUEUED)
        self._answers: deque[tuple[int, bytes, bytes | None]] = deque(maxlen=QUEUED)
        self._frame_id = 0
        self._clock = clock
        make = ports or SerialPort
        self._port = make(radio.port, radio.baud, "the radio", clock, self._take, HINT)

    @property
    def failure(self) -> str | None:
        """The reason why nothing can be sent any more; None without a fault."""
        return self._port.failure

    def open(self, checked: bool = True, alone: bool = True) -> None:
        """Open the port, exclusively if `alone`; check the module if `checked`."""
        self._port.open(alone)
        if checked:
            self.questions = hardware.check_module(self, self.radio)

    def send(self, data: bytes) -> int:
        """Broadcast data to all modules; return the time of writing [ns]."""
        return self._port.write(frames.encode(frames.BROADCAST + data))

    def ask(self, command: bytes) -> bytes | None:
        """Request a parameter of the module, named by two letters; return its value, None if it
        gives none within 0.3 s.
        """
        self._frame_id = self._frame_id % 255 + 1
        self._answers.clear()
        self._port.write(frames.encode(frames.at_command(self._frame_id, command)))
        asked = self._frame_id, command
        self._wait(lambda: any(answer[:2] == asked for answer in self._answers), ANSWER_S)
        return next((answer[2] for answer in self._answers if answer[:2] == asked), None)

    def set_baud(self, baud: int) -> None:
        """Change the baud rate of this side of the port."""
        self._port.set_baud(baud)

    def fetch(self) -> list[bytes]:
        """Return the data received from other modules since the last call."""
        return [self._fresh.popleft() for _ in range(len(self._fresh))]

    def wait(self, timeout_s: float) -> None:
        """Wait at most `timeout_s` until data from other modules can be fetched."""
        self._wait(lambda: bool(self._fresh), timeout_s)

    def close(self) -> None:
        """End the reading thread and release the port; may be called twice, never raises."""
        self._port.close()

    def _wait(self, done: Callable[[], bool], timeout_s: float) -> None:
        wait_for(self._clock, lambda: done() or self.failure is not None, timeout_s)

    def _take(self, data: bytes, now: int) -> None:
        for content in self._decoder.feed(data):
            if (answer := frames.answered(content)) is not None:
                self._answers.append(answer)
            elif sent := frames.received(content):
                self._fresh.append(sent)
