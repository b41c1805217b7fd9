"""The emulated radio: the XBee at the PC, UARTs, transmission, loss and acknowledgements; no I/O.

A frame takes time on the PC's UART, then, after a short random wait, 32 us per byte on the air,
then time on the robot's UART. Broadcasts are not acknowledged; a robot's answer is sent up to four
times, until it is acknowledged. The module answers AT commands that request a parameter.
"""

from collections.abc import Callable, Sequence
from typing import Any

from tetractl.lab.actuators.m3pi.broadcast import (
    BroadcastCommand,
    decode_command,
    encode_command,
)
from tetractl.lab.actuators.xbee.api_frames import (
    AT_COMMAND,
    AT_RESPONSE,
    BROADCAST,
    RESPONSE,
    STATUS_OK,
    Decoder,
    encode,
)
from tetractl.lab.actuators.xbee.hardware import BAUDS, ESCAPED_FRAMES
from tetractl.lab.cobs import Flag
from tetractl.model.wheels import Counts
from tetractl_emulator.faults import ActingFaults
from tetractl_emulator.loop import Timeline
from tetractl_emulator.m3pi.robot import EmulatedRobot
from tetractl_emulator.m3pi.robot_radio import RobotRadio
from tetractl_emulator.port import PseudoPort, uart_ns

RECEIVED = bytes.fromhex("81 00 01 28 00")  # data from address 1 at -40 dBm
AIR_NS_A_BYTE = 32_000
AIR_OVERHEAD = 17  # bytes: preamble, header, checksum
BACKOFF_NS = 320_000  # longest random wait before a transmission
ACK_NS = 860_000  # time a sender waits for an acknowledgement
ROBOT_BAUD = 57600
INVALID_COMMAND = 2  # status of an answer: the module has no such parameter


def at_response(frame_id: int, command: bytes, value: bytes | None) -> bytes:
    """Return the content that answers a request.

    Args:
        frame_id: Number of the request.
        command: Its two letters.
        value: The value. None for an unknown parameter.
    """
    status = INVALID_COMMAND if value is None else STATUS_OK
    return RESPONSE.pack(AT_RESPONSE, frame_id, command, status) + (value or b"")


class EmulatedRadio(RobotRadio):
    """The PC's radio module on its port, and one module per robot.

    Args:
        timeline: The timeline of the emulation.
        port: The port of the PC's module.
        baud: Speed of the port [bits per second].
        versions: Hardware version (HV) and firmware version (VR) of the PC's module.
        robots: The robots.
        loss: Fraction of the transmissions that are lost.
        seed: Determines what is lost and late.
        note: Called with each command when it is read from the port: `sequence`, `flags`, and the
            `wheels` of all robots. None if no record is kept.
        acting: The faults that act now. None for none.
    """

    def __init__(
        self,
        timeline: Timeline,
        port: PseudoPort,
        baud: int,
        versions: tuple[int, int],
        robots: Sequence[EmulatedRobot],
        loss: float,
        seed: int,
        note: Callable[..., None] | None,
        acting: ActingFaults | None = None,
    ) -> None:
        super().__init__(timeline, port, baud, note, robots, loss, seed, acting)
        self._decoder = Decoder()
        self._witnessed = Decoder()
        self._air_ns = 0  # when the air is free again
        self._parameters = {
            b"HV": versions[0].to_bytes(2, "big"),
            b"VR": versions[1].to_bytes(2, "big"),
            b"BD": BAUDS.index(baud).to_bytes(4, "big"),
            b"AP": bytes((ESCAPED_FRAMES,)),
        }

    def hear(self, data: bytes) -> None:
        """Take bytes that the module's UART has received from the PC."""
        for content in self._decoder.feed(data):
            if content.startswith(BROADCAST):
                self._transmit(content[len(BROADCAST) :])
            elif content[0] == AT_COMMAND and len(content) >= 4:
                command = content[2:4]
                value = self._parameters.get(command) if len(content) == 4 else None
                self._answer(encode(at_response(content[1], command, value)))

    def _witness(self, data: bytes) -> None:
        for content in self._witnessed.feed(data):
            if not content.startswith(BROADCAST):
                continue
            self._note_commands(self._splitter.feed(content[len(BROADCAST) :]))

    def _command(self, sealed: bytes) -> dict[str, Any]:
        command = decode_command(sealed)
        flags = int(command.flags)
        wheels = command.wheels
        return {"sequence": command.sequence, "flags": flags, "wheels": wheels}

    def stop_elsewhere(self, sequence: int) -> None:
        """Transmit an emergency stop that no program of ours has sent."""
        self._transmit(encode_command(BroadcastCommand(sequence, Flag.EMERGENCY_STOP)))

    def drive_elsewhere(self, sequence: int, counts: Counts) -> None:
        """Transmit a command of another program, that all robots drive by these counts."""
        numbers = 1 + max(robot.index for robot in self.robots)
        self._transmit(encode_command(BroadcastCommand(sequence, Flag.RUN, (counts,) * numbers)))

    def poll_answers(self) -> None:
        """Send the answers that robots have ready; to be called about every millisecond."""
        for robot in self.robots:
            if answer := robot.answer():
                ready = self._timeline.now_ns + uart_ns(len(answer), ROBOT_BAUD)
                self._timeline.at(ready, lambda answer=answer: self._reply(answer))

    def _take_air(self, size: int) -> int:
        """Reserve the radio channel to send `size` bytes, and return when that ends [ns]."""
        start = max(self._timeline.now_ns, self._air_ns)
        wait = round(self._random.uniform(0, BACKOFF_NS))
        self._air_ns = start + wait + (size + AIR_OVERHEAD) * AIR_NS_A_BYTE
        return self._air_ns

    def _transmit(self, payload: bytes) -> None:
        size = len(payload)
        self.pass_on(payload, self._take_air(size) + uart_ns(size, ROBOT_BAUD))

    def _reply(self, payload: bytes) -> None:
        for _ in range(4):
            arrives = self._take_air(len(payload))
            self._air_ns += ACK_NS
            if self._random.random() >= self.loss_to():
                self._timeline.at(arrives, lambda: self._answer(encode(RECEIVED + payload)))
                return
