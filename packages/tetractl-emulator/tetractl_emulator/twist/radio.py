"""A port of emulated robots that receive lines: serial, radio or UDP. No I/O."""

from collections.abc import Sequence
from typing import Any

from tetractl.core.clock import MILLISECOND
from tetractl.lab.actuators.twist.lines import LineCommand, decode_command, encode_command
from tetractl.lab.cobs import Flag
from tetractl.model.wheels import Counts
from tetractl_emulator.m3pi.robot import EmulatedRobot
from tetractl_emulator.m3pi.robot_radio import RobotRadio
from tetractl_emulator.port import PseudoPort
from tetractl_emulator.sides import Stage

COUNT_MM_S = 8
"""Wheel speed of an m3pi robot for one count of its motor [mm/s]."""
LINE_DELAY_NS = 2 * MILLISECOND
"""Time from the end of a line at the radio to its arrival at the robots [ns]; a guess."""


class LineRadio(RobotRadio):
    """Delivers lines from a port to robots, and sends the robots' replies back.

    Args:
        stage: The data and functions that the emulated devices share.
        port: The port at which a program sends lines.
        baud: Speed of the port [bits/s].
        robots: The robots that receive the lines.
        indices: Numbers of all robots of the setup.
        loss: Minimum probability that a line is lost.
        seed: Seed of the random losses and delays.

    Attributes:
        end: The bytes at the end of each message to a robot.
    """

    end = b"\n"

    def __init__(
        self,
        stage: Stage,
        port: PseudoPort,
        baud: int,
        robots: Sequence[EmulatedRobot],
        indices: Sequence[int],
        loss: float,
        seed: int,
    ) -> None:
        super().__init__(stage.timeline, port, baud, stage.note, robots, loss, seed, stage.acting)
        self._indices = indices
        self._received_part = b""
        self._recorded_part = b""

    def receive(self, data: bytes) -> None:
        """Process received bytes. Only complete lines are delivered to robots."""
        *lines, self._received_part = self._split(self._received_part + data)
        for line in lines:
            self.deliver(line + self.end, self._timeline.now_ns + LINE_DELAY_NS)

    def _split(self, data: bytes) -> list[bytes]:
        """Split received data into the complete lines, followed by the incomplete last line.

        The newlines are removed. The last line is b"" if the data ends with a newline.
        """
        return data.split(b"\n")

    def stop_from_other_program(self, sequence: int) -> None:
        """Deliver an emergency stop to the robots, as if another program had sent it."""
        self.receive(encode_command(LineCommand("W", sequence, Flag.EMERGENCY_STOP)))

    def drive_from_other_program(self, sequence: int, counts: Counts) -> None:
        """Deliver a command that drives all robots, as if from another program.

        Args:
            sequence: Sequence number of the command.
            counts: Counts of the left and the right motor. One count becomes COUNT_MM_S.
        """
        left, right = (COUNT_MM_S * count for count in counts)
        entries = tuple((index, left, right) for index in self._indices)
        self.receive(encode_command(LineCommand("W", sequence, Flag.RUN, entries)))

    def _decode_command(self, frame: bytes) -> dict[str, Any]:
        """Decode a command for the record: sequence, flags, entries, and which robots it drives.

        WireError is raised if it is damaged.
        """
        command = decode_command(frame)
        driven = [index for index, *speeds in command.entries if any(speeds)]
        drives = [command.flags & Flag.RUN and index in driven for index in self._indices]
        record = {"kind": command.kind, "entries": command.entries, "drives": [*map(bool, drives)]}
        return {"sequence": command.sequence, "flags": int(command.flags), **record}

    def _record_commands(self, data: bytes) -> None:
        """Record the commands in bytes that were read from the port.

        The beginning of an incomplete line is kept until the other bytes of the line arrive.
        """
        *lines, self._recorded_part = self._split(self._recorded_part + data)
        self._record_frames(lines)
