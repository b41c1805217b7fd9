"""Which commands were sent over the serial port, and when they were there."""

from collections.abc import Callable

from tetractl.lab.actuators.m3pi.broadcast import decode_command
from tetractl.lab.actuators.m3pi.slave import Motor, MotorCount, SlaveDecoder
from tetractl.lab.actuators.xbee.frames import Transmit16
from tetractl.lab.actuators.xbee.framing import Decoder
from tetractl.lab.cobs import Splitter
from tetractl.lab.errors import WireError

Note = Callable[..., None]


class CommandLog:
    """Notes each command as it is read from the port, before it travels any further.

    `mode` is AP. A broadcast is noted with `sequence`, `flags` and the `wheels` of all robots; a
    slave's with its `address` and the `wheels` as they stand for it then.
    """

    def __init__(self, mode: int, slave: bool, note: Note) -> None:
        self._note = note
        self._slave = slave
        self._api = Decoder(escaped=mode == 2) if mode else None
        self._splitters: dict[int, Splitter] = {}
        self._slaves: dict[int, tuple[SlaveDecoder, list[int]]] = {}

    def read(self, data: bytes) -> None:
        """Note the commands that these bytes complete."""
        if self._api is None:
            self._payload(0xFFFF, data)
            return
        for frame in self._api.feed(data):
            if isinstance(frame, Transmit16):
                self._payload(frame.destination, frame.data)

    def _payload(self, address: int, data: bytes) -> None:
        if self._slave:
            self._slave_bytes(address, data)
            return
        for sealed in self._splitters.setdefault(address, Splitter()).feed(data):
            try:
                command = decode_command(sealed)
            except WireError:
                self._note("garbage", hex=sealed.hex())
                continue
            self._note(
                "command",
                sequence=command.sequence,
                flags=int(command.flags),
                wheels=command.wheels,
            )

    def _slave_bytes(self, address: int, data: bytes) -> None:
        decoder, wheels = self._slaves.setdefault(address, (SlaveDecoder(), [0, 0]))
        counts = [item for item in decoder.feed(data) if isinstance(item, MotorCount)]
        for each in counts:
            wheels[each.motor is Motor.M2] = each.count
        if counts:
            self._note("command", address=address, wheels=[list(wheels)])
