"""Reads along on the serial port: which commands were sent, and when they were there."""

from collections.abc import Callable

from tetractl.lab.actuators.m3pi.broadcast import decode_command
from tetractl.lab.actuators.m3pi.cobs import Splitter
from tetractl.lab.actuators.m3pi.slave import Drive, Motor, SlaveDecoder
from tetractl.lab.actuators.xbee.frames import Transmit, Transmit16, Transmit64
from tetractl.lab.actuators.xbee.framing import Decoder
from tetractl.lab.errors import WireError

Tell = Callable[..., None]


class Witness:
    """Tells of each command as it is read from the port, before it travels any further.

    `mode` is AP. A broadcast is told with `sequence`, `flags` and the `wheels` of all robots; a
    slave's with its `address` and the `wheels` as they stand for it then.
    """

    def __init__(self, mode: int, slave: bool, tell: Tell) -> None:
        self._tell = tell
        self._slave = slave
        self._api = Decoder(escaped=mode == 2) if mode else None
        self._splitters: dict[int, Splitter] = {}
        self._slaves: dict[int, tuple[SlaveDecoder, list[int]]] = {}

    def read(self, data: bytes) -> None:
        """Take bytes as they came."""
        if self._api is None:
            self._payload(0xFFFF, data)
            return
        for frame in self._api.feed(data):
            if isinstance(frame, Transmit | Transmit16 | Transmit64):
                self._payload(frame.destination, frame.data)

    def _payload(self, address: int, data: bytes) -> None:
        if self._slave:
            self._slave_bytes(address, data)
            return
        for sealed in self._splitters.setdefault(address, Splitter()).feed(data):
            try:
                command = decode_command(sealed)
            except WireError:
                self._tell("garbage", hex=sealed.hex())
                continue
            self._tell(
                "command",
                sequence=command.sequence,
                flags=int(command.flags),
                wheels=command.wheels,
            )

    def _slave_bytes(self, address: int, data: bytes) -> None:
        decoder, wheels = self._slaves.setdefault(address, (SlaveDecoder(), [0, 0]))
        drives = [item for item in decoder.feed(data) if isinstance(item, Drive)]
        for drive in drives:
            wheels[drive.motor is Motor.M2] = drive.count
        if drives:
            self._tell("command", address=address, wheels=[list(wheels)])
