"""The emulated XBee at the PC: what it makes of the bytes on its UART, without I/O.

It answers AT commands and says what became of each send. In transparent mode bytes go as they
are, and `+++` between two silences of a second opens its command mode.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum

from tetractl.core.clock import SECOND
from tetractl.lab.actuators.xbee.frames import (
    BROADCAST_16,
    BROADCAST_64,
    EXPLICIT_RECEIVE,
    AtCommand,
    AtResponse,
    Other,
    Receive16,
    RemoteAt,
    RemoteAtResponse,
    Transmit,
    Transmit16,
    Transmit64,
    TransmitStatus,
    TransmitStatusLong,
    XbeeFrame,
)
from tetractl.lab.actuators.xbee.framing import Decoder, encode

GUARD_NS = SECOND
RSSI = 40  # -dBm
BAUDS = {1200: 0, 2400: 1, 4800: 2, 9600: 3, 19200: 4, 38400: 5, 57600: 6, 115200: 7}
SERIAL_HIGH = 0x0013A200  # the upper half of every module's 64-bit address
SERIAL_LOW = 0x40000000  # the lower half, before adding the 16-bit address


class Delivery(IntEnum):
    """What became of a send, as 0x89 says it."""

    SUCCESS = 0
    NO_ACK = 1


Done = Callable[[Delivery], None]
Send = Callable[[int, bytes, Done], None]  # 16-bit address, payload
Write = Callable[[bytes], None]


@dataclass(slots=True)
class ModuleSettings:
    """What the module was set to; `mode` is AP, `explicit` whether AO is 1."""

    baud: int = 57600
    mode: int = 2
    hardware: int = 0x1744  # HV: Series 1
    firmware: int = 0x10EC  # VR: 802.15.4
    address: int = 0
    explicit: bool = False
    other: dict[bytes, int] = field(
        default_factory=lambda: {b"CH": 0x0C, b"ID": 0x3332, b"DH": 0, b"DL": BROADCAST_16}
    )


class EmulatedModule:
    """An XBee; `send` puts a payload on the air, `write` bytes on the UART towards the PC."""

    def __init__(self, settings: ModuleSettings, send: Send, write: Write) -> None:
        self.settings = settings
        self._send = send
        self._write = write
        self._decoder = Decoder(escaped=settings.mode == 2)
        self._commanding = False  # in the command mode of transparent mode
        self._line = b""
        self._heard_ns = -GUARD_NS

    def hear(self, data: bytes, now_ns: int) -> None:
        """Take bytes from the PC, as its UART has received them."""
        if self.settings.mode:
            for frame in self._decoder.feed(data):
                self._obey(frame)
            return
        silence, self._heard_ns = now_ns - self._heard_ns, now_ns
        if self._commanding:
            self._type(data)
        elif data == b"+++" and silence >= GUARD_NS:
            self._commanding = True
            self._write(b"OK\r")
        else:
            for start in range(0, len(data), 100):
                self._send(self.settings.other[b"DL"], data[start : start + 100], _ignore)

    def receive(self, source: int, payload: bytes) -> None:
        """Take a payload from the air."""
        if not self.settings.mode:
            self._write(payload)
        elif self.settings.explicit:  # both addresses, endpoints, cluster, profile, options
            sender = (SERIAL_HIGH << 32 | SERIAL_LOW + source).to_bytes(8, "big")
            head = sender + source.to_bytes(2, "big") + bytes.fromhex("E8E80011C10501")
            self._tell(Other(EXPLICIT_RECEIVE, head + payload))
        else:
            self._tell(Receive16(source, RSSI, 0, payload))

    def _tell(self, frame: XbeeFrame | Other) -> None:
        self._write(encode(frame, escaped=self.settings.mode == 2))

    def _obey(self, frame: XbeeFrame | Other) -> None:
        match frame:
            case AtCommand(frame_id, command, data):
                status, value = self._at(command, data)
                if frame_id:
                    self._tell(AtResponse(frame_id, command, status, value))
            case Transmit16(frame_id, destination, _, data):
                self._send(destination, data, self._short_status(frame_id))
            case Transmit64(frame_id, destination, _, data):
                self._send(_short(destination), data, self._short_status(frame_id))
            case Transmit(frame_id, destination, _, _, _, data):
                self._send(_short(destination), data, self._long_status(frame_id))
            case RemoteAt(frame_id, destination, short, _, command, _) if frame_id:
                # 802.15.4 modules at the robots are not configured over the air
                self._tell(RemoteAtResponse(frame_id, destination, short, command, 4))
            case _:
                pass  # a module says nothing to frames it does not know

    def _short_status(self, frame_id: int) -> Done:
        def tell(delivery: Delivery) -> None:
            if frame_id:
                self._tell(TransmitStatus(frame_id, delivery))

        return tell

    def _long_status(self, frame_id: int) -> Done:
        def tell(delivery: Delivery) -> None:
            if frame_id:
                self._tell(TransmitStatusLong(frame_id, 0xFFFE, 0, delivery, 0))

        return tell

    def _at(self, command: bytes, data: bytes) -> tuple[int, bytes]:
        """Return status (0 good, 1 error, 2 unknown command, 3 bad parameter) and value."""
        read_only = {
            b"HV": (self.settings.hardware, 2),
            b"VR": (self.settings.firmware, 2),
            b"SH": (SERIAL_HIGH, 4),
            b"SL": (SERIAL_LOW + self.settings.address, 4),
            b"BD": (BAUDS[self.settings.baud], 4),
            b"AP": (self.settings.mode, 1),
            b"MY": (self.settings.address, 2),
            b"DB": (RSSI, 1),
        }
        if command in (b"CN", b"WR", b"AC"):
            return 0, b""
        if command in self.settings.other:
            if data:
                self.settings.other[command] = int.from_bytes(data[-4:], "big")
                return 0, b""
            size = 1 if command == b"CH" else 4 if command in (b"DH", b"DL") else 2
            return 0, self.settings.other[command].to_bytes(4, "big")[4 - size :]
        if command == b"AP" and data:
            if data[-1] > 2:
                return 3, b""
            self.settings.mode = data[-1]
            self._decoder = Decoder(escaped=data[-1] == 2)
            return 0, b""
        if command not in read_only:
            return 2, b""
        if data:
            return 3, b""  # emulated modules keep their address and speed
        value, size = read_only[command]
        return 0, value.to_bytes(size, "big")

    def _type(self, data: bytes) -> None:
        """Take what is typed in command mode: `ATxx` and a value in hex, closed by CR."""
        *lines, self._line = (self._line + data).split(b"\r")
        for line in lines:
            word = line.strip().upper()
            try:
                value = bytes.fromhex(word[4:].decode().rjust(8, "0")) if word[4:] else b""
            except ValueError:
                word, value = b"", b""
            if word[:2] != b"AT" or len(word) < 4:
                self._write(b"ERROR\r")
                continue
            status, answer = self._at(word[2:4], value)
            if status:
                self._write(b"ERROR\r")
            else:
                self._write(
                    (answer.hex().upper().lstrip("0") or "0").encode() + b"\r"
                    if answer
                    else b"OK\r"
                )
            if word[2:4] == b"CN":
                self._commanding = False


def _short(destination: int) -> int:
    """Return the 16-bit address of a 64-bit one."""
    if destination == BROADCAST_64:
        return BROADCAST_16
    return (destination - SERIAL_LOW) & 0xFFFF if destination >> 32 == SERIAL_HIGH else 0xFFFD


def _ignore(delivery: Delivery) -> None:
    """Do nothing: in transparent mode nobody is told."""
