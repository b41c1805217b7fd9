"""One port of emulated robots that take lines: serial or UDP, and a transparent radio; no I/O."""

import random
from collections.abc import Callable, Sequence
from typing import Any

from tetractl.core.clock import MILLISECOND
from tetractl.lab.actuators.twist.lines import decode_command
from tetractl_emulator.m3pi.robot import EmulatedRobot
from tetractl_emulator.port import PseudoPort, SerialDevice
from tetractl_emulator.sides import Stage

DELAY_NS = 2 * MILLISECOND  # guess: from the end of a line at the radio to the robots


class LineRadio(SerialDevice):
    """Passes lines on `port` to `robots`, each of which loses one with the probability `loss()`,
    and their replies back."""

    def __init__(
        self,
        stage: Stage,
        port: PseudoPort,
        baud: int,
        robots: Sequence[EmulatedRobot],
        loss: Callable[[], float],
        seed: int,
    ) -> None:
        super().__init__(stage.timeline, port, baud, stage.note)
        self.robots, self._loss = robots, loss
        self._random = random.Random(seed)
        self._line, self._witnessed = b"", b""

    def hear(self, data: bytes) -> None:
        """Take bytes that have come over the line; robots hear whole lines or none."""
        *lines, self._line = (self._line + data).split(b"\n")
        for line in lines:
            arrives = self._timeline.now_ns + DELAY_NS
            for robot in self.robots:
                if self._random.random() >= self._loss():
                    self._timeline.at(arrives, lambda robot=robot, line=line: _hear(robot, line))

    def _command(self, sealed: bytes) -> dict[str, Any]:
        command = decode_command(sealed)
        own = {"kind": command.kind, "entries": command.entries}
        return {"sequence": command.sequence, "flags": int(command.flags), **own}

    def _witness(self, data: bytes) -> None:
        *lines, self._witnessed = (self._witnessed + data).split(b"\n")
        self._note_commands(lines)

    def poll_answers(self) -> None:
        """Send the replies that robots have ready; to be called about every millisecond."""
        for robot in self.robots:
            if answer := robot.answer():
                self._answer(answer)


def _hear(robot: EmulatedRobot, line: bytes) -> None:
    robot.hear(line + b"\n")
