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

MM_S_A_COUNT = 8  # speed of a wheel of an m3pi for a count [mm/s]
DELAY_NS = 2 * MILLISECOND  # guess: from the end of a line at the radio to the robots


class LineRadio(RobotRadio):
    """Delivers the lines that a program sends at a port to robots, and sends back their replies.

    Args:
        stage: What the emulated devices share.
        port: The port.
        baud: Speed of the port [bits/s].
        robots: The robots that receive the lines.
        indices: Numbers of all robots of the setup.
        loss: Minimum probability that a line is lost.
        seed: Seed of what is lost or late.
    """

    end = b"\n"  # of a line

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
        self._line = b""
        self._witnessed = b""

    def hear(self, data: bytes) -> None:
        """Process received bytes. Only complete lines are delivered to robots."""
        *lines, self._line = self._split(self._line + data)
        for line in lines:
            self.pass_on(line + self.end, self._timeline.now_ns + DELAY_NS)

    def _split(self, data: bytes) -> list[bytes]:
        """Return the complete lines in the data, followed by the incomplete rest.

        Their ends are removed. The rest is b"" if the data ends with a line.
        """
        return data.split(b"\n")

    def stop_elsewhere(self, sequence: int) -> None:
        """Deliver an emergency stop to the robots, as if another program had sent it."""
        self.hear(encode_command(LineCommand("W", sequence, Flag.EMERGENCY_STOP)))

    def drive_elsewhere(self, sequence: int, counts: Counts) -> None:
        """Deliver a command that drives all robots, as if from another program.

        Args:
            sequence: Sequence number of the command.
            counts: Counts of the left and the right motor, each converted to MM_S_A_COUNT mm/s.
        """
        left, right = (MM_S_A_COUNT * count for count in counts)
        entries = tuple((index, left, right) for index in self._indices)
        self.hear(encode_command(LineCommand("W", sequence, Flag.RUN, entries)))

    def _command(self, sealed: bytes) -> dict[str, Any]:
        """Decode a command for the record: sequence, flags, entries, and which robots it drives.

        WireError is raised if it is damaged.
        """
        command = decode_command(sealed)
        driven = [index for index, *speeds in command.entries if any(speeds)]
        drives = [command.flags & Flag.RUN and index in driven for index in self._indices]
        record = {"kind": command.kind, "entries": command.entries, "drives": [*map(bool, drives)]}
        return {"sequence": command.sequence, "flags": int(command.flags), **record}

    def _witness(self, data: bytes) -> None:
        """Record the commands in bytes that were read from the port.

        An incomplete line is kept until its rest arrives.
        """
        *lines, self._witnessed = self._split(self._witnessed + data)
        self._note_commands(lines)
