"""The emulated XBee at the PC: what it makes of the bytes on its UART, without I/O.

It answers AT commands that ask for a parameter, and says what became of each send. In transparent
mode bytes go as they are.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

from tetractl.lab.actuators.xbee.frames import (
    BROADCAST_16,
    EXPLICIT_RECEIVE,
    AtCommand,
    AtResponse,
    Other,
    Receive16,
    Transmit16,
    TransmitStatus,
    XbeeFrame,
)
from tetractl.lab.actuators.xbee.framing import Decoder, encode
from tetractl.lab.actuators.xbee.hardware import BAUDS

RSSI = 40  # -dBm
PAYLOAD = 100  # bytes of 802.15.4
SERIAL = 0x0013A200_40000000  # of every module's 64-bit address, before adding the 16-bit one


class Delivery(IntEnum):
    """What became of a send, as 0x89 says it."""

    SUCCESS = 0
    NO_ACK = 1


Done = Callable[[Delivery], None]
Send = Callable[[int, bytes, Done], None]  # 16-bit address, payload
Write = Callable[[bytes], None]


@dataclass(frozen=True, slots=True)
class ModuleSettings:
    """What the module was set to; `mode` is AP, `explicit` whether AO is 1."""

    baud: int = 57600
    mode: int = 2
    hardware: int = 0x1744  # HV: Series 1
    firmware: int = 0x10EC  # VR: 802.15.4
    explicit: bool = False


class EmulatedModule:
    """An XBee; `send` puts a payload on the air, `write` bytes on the UART towards the PC."""

    def __init__(self, settings: ModuleSettings, send: Send, write: Write) -> None:
        self.settings = settings
        self._send = send
        self._write = write
        self._decoder = Decoder(escaped=settings.mode == 2)
        self._parameters = {
            b"HV": settings.hardware.to_bytes(2, "big"),
            b"VR": settings.firmware.to_bytes(2, "big"),
            b"BD": BAUDS.index(settings.baud).to_bytes(4, "big"),
            b"AP": bytes([settings.mode]),
        }

    def hear(self, data: bytes) -> None:
        """Take bytes from the PC, as its UART has received them."""
        if self.settings.mode:
            for frame in self._decoder.feed(data):
                self._obey(frame)
            return
        for start in range(0, len(data), PAYLOAD):
            self._send(BROADCAST_16, data[start : start + PAYLOAD], lambda delivery: None)

    def receive(self, source: int, payload: bytes) -> None:
        """Take a payload from the air."""
        if not self.settings.mode:
            self._write(payload)
        elif self.settings.explicit:  # both addresses, endpoints, cluster, profile, options
            sender = (SERIAL + source).to_bytes(8, "big")
            head = sender + source.to_bytes(2, "big") + bytes.fromhex("E8E80011C10501")
            self._answer(Other(EXPLICIT_RECEIVE, head + payload))
        else:
            self._answer(Receive16(source, RSSI, 0, payload))

    def _answer(self, frame: XbeeFrame | Other) -> None:
        self._write(encode(frame, escaped=self.settings.mode == 2))

    def _obey(self, frame: XbeeFrame | Other) -> None:
        match frame:
            case AtCommand(frame_id, command, data):
                value = None if data else self._parameters.get(command)
                status = 2 if value is None else 0  # 2: an invalid command
                self._answer(AtResponse(frame_id, command, status, value or b""))
            case Transmit16(frame_id, destination, _, data):
                self._send(destination, data, self._status(frame_id))
            case _:
                pass  # a module says nothing to frames it does not know

    def _status(self, frame_id: int) -> Done:
        def done(delivery: Delivery) -> None:
            if frame_id:
                self._answer(TransmitStatus(frame_id, delivery))

        return done
