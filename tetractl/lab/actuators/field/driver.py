"""The current driver at the other end of a serial port: numbered frames out, replies in."""

import threading
from contextlib import suppress

from tetractl.core.clock import SECOND, Clock, wait_for
from tetractl.core.errors import WireError
from tetractl.lab.actuators.field.driver_protocol import (
    DriverStatus,
    FieldCommand,
    FieldFlag,
    FieldReply,
    decode_reply,
    encode_command,
)
from tetractl.lab.cobs import Splitter
from tetractl.lab.serial_port import SerialPort

SILENCE_NS = SECOND // 2
# more frames than this, over more than this time, without a reply: the driver is off
UNANSWERED_MAX = 5
TRIES = 5
ANSWER_S = 0.1  # a driver replies within 4 ms at 115200 baud, 50 ms at 9600
HINT = "the driver switches the field off by its watchdog; cells swim on"


class Driver:
    """A current driver on a port that is opened by `open`. Times are ns on `clock`.

    Every frame polls, so that a driver which is off, latched or hot is noticed during a run:
    `failure` then says so.
    """

    def __init__(self, port: str, baud: int, clock: Clock) -> None:
        self.newest: FieldReply | None = None
        self._clock = clock
        self._port = SerialPort(port, baud, "the current driver", clock, self._hear, HINT)
        self._splitter = Splitter()
        self._lock = threading.Lock()
        self._sequence = 0
        self._unanswered = 0  # frames since the last reply, and when the first of them left
        self._unanswered_ns = 0

    @property
    def failure(self) -> str | None:
        """Why the driver makes no field any more, None while all is well."""
        newest, now_ns = self.newest, self._clock.now()
        if self._port.failure is not None:
            return self._port.failure
        if self._unanswered > UNANSWERED_MAX and now_ns - self._unanswered_ns > SILENCE_NS:
            return "the current driver does not answer any more"
        if newest is not None and DriverStatus.HOT in newest.status:
            return f"the current driver stopped: it is {newest.temperature_dc / 10:.0f} °C hot"
        if newest is not None and DriverStatus.EMERGENCY_STOPPED in newest.status:
            return "the current driver is emergency-stopped"
        return None

    def open(self) -> None:
        """Open the port; AbortError if that cannot be."""
        self._port.open()

    def send(self, flags: FieldFlag, x_ma: int = 0, y_ma: int = 0) -> int:
        """Send a command that polls; return when it left. AbortError if the port has failed."""
        with self._lock:
            self._sequence = (self._sequence + 1) % 256
            command = FieldCommand(self._sequence, flags | FieldFlag.POLL, x_ma, y_ma)
            sent_ns = self._port.write(encode_command(command))
            if self._unanswered == 0:
                self._unanswered_ns = sent_ns
            self._unanswered += 1
        return sent_ns

    def ask(self) -> FieldReply | None:
        """Poll without running, up to five times 0.1 s; return the reply, None if none came.

        This switches a field off. AbortError if the port has failed.
        """
        self.newest = None
        for _ in range(TRIES):
            self.send(FieldFlag(0))
            wanted = self._sequence
            wait_for(
                self._clock,
                lambda w=wanted: self._port.failure is not None or self._answered(w),
                ANSWER_S,
            )
            if self._answered(wanted):
                return self.newest
        return None

    def close(self) -> None:
        """Close the port; idempotent, never raises."""
        self._port.close()

    def _answered(self, sequence: int) -> bool:
        return self.newest is not None and self.newest.sequence == sequence

    def _hear(self, data: bytes, now_ns: int) -> None:
        with self._lock:
            for frame in self._splitter.feed(data):
                with suppress(WireError):  # a damaged reply counts as missing
                    self.newest = decode_reply(frame)
                    self._unanswered = 0
