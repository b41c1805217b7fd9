"""The emulated XBee radio of the PC and the robots: its timing, losses and answers. No I/O.

A frame takes time on the PC's UART, then, after a short random wait, 32 us per byte on the air,
then time on the robot's UART. Broadcasts are not acknowledged. A robot's answer is sent up to four
times, until it is acknowledged. The PC's module answers AT commands that request a parameter.
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
from tetractl.lab.actuators.xbee.hardware import BAUD_RATES, ESCAPED_API_MODE
from tetractl.lab.cobs import Flag
from tetractl.model.wheels import Counts
from tetractl_emulator.faults import ActingFaults
from tetractl_emulator.loop import Timeline
from tetractl_emulator.m3pi.robot import EmulatedRobot
from tetractl_emulator.m3pi.robot_radio import RobotRadio
from tetractl_emulator.port import PseudoPort, uart_ns

RECEIVED_HEADER = bytes.fromhex("81 00 01 28 00")
"""First bytes of a frame with data that the PC's module received, from address 1 at -40 dBm."""
AIR_NS_PER_BYTE = 32_000
"""Time that a byte takes on the air [ns]."""
AIR_OVERHEAD_BYTES = 17
"""Number of bytes that each transmission adds: preamble, header and checksum."""
BACKOFF_MAX_NS = 320_000
"""Maximum random wait before a transmission [ns]."""
ACK_NS = 860_000
"""Time for which a sender waits for an acknowledgement [ns]."""
ROBOT_BAUD = 57600
"""Speed of the serial line between a robot and its radio module [bits/s]."""
INVALID_COMMAND = 2
"""Status of an answer if the module has no such parameter."""


def encode_at_response(frame_id: int, command: bytes, value: bytes | None) -> bytes:
    """Encode the content of the frame that answers a request for a parameter.

    Args:
        frame_id: Number of the request.
        command: The parameter's two letters.
        value: Value of the parameter. None for an unknown parameter.
    """
    status = INVALID_COMMAND if value is None else STATUS_OK
    return RESPONSE.pack(AT_RESPONSE, frame_id, command, status) + (value or b"")


class EmulatedRadio(RobotRadio):
    """The PC's XBee module on its port, and one module per robot.

    Each command is recorded when it is read from the port, with its `sequence`, `flags` and the
    `wheels` of all robots.

    Args:
        timeline: The emulation's timeline.
        port: The port of the PC's module.
        baud: Speed of the port [bits/s].
        versions: Hardware version (HV) and firmware version (VR) of the PC's module.
        robots: The robots.
        loss: Probability that a transmission is lost.
        seed: Seed of the random losses and delays.
        note: Records an event, called as `note(event, **facts)`. None if there is no record.
        acting: The faults that act now. None if no fault can act.
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
        self._record_decoder = Decoder()
        self._air_free_ns = 0  # when the air is free again
        self._parameters = {
            b"HV": versions[0].to_bytes(2, "big"),
            b"VR": versions[1].to_bytes(2, "big"),
            b"BD": BAUD_RATES.index(baud).to_bytes(4, "big"),
            b"AP": bytes((ESCAPED_API_MODE,)),
        }

    def receive(self, data: bytes) -> None:
        """Process bytes that the module has received from the PC.

        A broadcast is transmitted, and a request for a parameter is answered.
        """
        for content in self._decoder.feed(data):
            if content.startswith(BROADCAST):
                self._transmit(content[len(BROADCAST) :])
            elif content[0] == AT_COMMAND and len(content) >= 4:
                command = content[2:4]
                value = self._parameters.get(command) if len(content) == 4 else None
                self._send_to_program(encode(encode_at_response(content[1], command, value)))

    def _record_commands(self, data: bytes) -> None:
        """Record the commands in bytes that were read from the port. Other contents are ignored."""
        for content in self._record_decoder.feed(data):
            if not content.startswith(BROADCAST):
                continue
            self._record_frames(self._frame_splitter.feed(content[len(BROADCAST) :]))

    def _decode_command(self, frame: bytes) -> dict[str, Any]:
        """Decode a command for the record: its sequence number, flags and wheel counts.

        WireError is raised if it is damaged.
        """
        command = decode_command(frame)
        flags = int(command.flags)
        wheels = command.wheels
        return {"sequence": command.sequence, "flags": flags, "wheels": wheels}

    def stop_from_other_program(self, sequence: int) -> None:
        """Transmit an emergency stop with this sequence number, as if from another program."""
        self._transmit(encode_command(BroadcastCommand(sequence, Flag.EMERGENCY_STOP)))

    def drive_from_other_program(self, sequence: int, counts: Counts) -> None:
        """Transmit a command that drives all robots, as if from another program.

        Args:
            sequence: Sequence number of the command.
            counts: Counts of the left and the right motor of each robot.
        """
        n_entries = 1 + max(robot.index for robot in self.robots)
        self._transmit(encode_command(BroadcastCommand(sequence, Flag.RUN, (counts,) * n_entries)))

    def poll_answers(self) -> None:
        """Transmit the robots' waiting answers to the PC. To be called about every millisecond."""
        for robot in self.robots:
            if answer := robot.answer():
                ready_ns = self._timeline.now_ns + uart_ns(len(answer), ROBOT_BAUD)
                self._timeline.at(ready_ns, lambda answer=answer: self._reply(answer))

    def _reserve_air(self, size: int) -> int:
        """Reserve the radio channel for `size` bytes, after a random wait once it is free.

        Returns:
            The time at which the transmission ends, on the timeline [ns].
        """
        start_ns = max(self._timeline.now_ns, self._air_free_ns)
        wait_ns = round(self._random.uniform(0, BACKOFF_MAX_NS))
        self._air_free_ns = start_ns + wait_ns + (size + AIR_OVERHEAD_BYTES) * AIR_NS_PER_BYTE
        return self._air_free_ns

    def _transmit(self, payload: bytes) -> None:
        """Broadcast a payload to all robots.

        The robots receive the payload after its times on the air and on their serial lines.
        """
        size = len(payload)
        self.deliver(payload, self._reserve_air(size) + uart_ns(size, ROBOT_BAUD))

    def _reply(self, payload: bytes) -> None:
        """Transmit a robot's answer to the PC, up to four times until one attempt is not lost.

        If all attempts are lost, the PC gets no answer.
        """
        for _ in range(4):
            arrival_ns = self._reserve_air(len(payload))
            self._air_free_ns += ACK_NS
            if self._random.random() >= self.loss_probability():
                self._timeline.at(
                    arrival_ns, lambda: self._send_to_program(encode(RECEIVED_HEADER + payload))
                )
                return
