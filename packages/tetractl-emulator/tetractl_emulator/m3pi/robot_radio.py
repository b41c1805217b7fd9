"""What all emulated radios do on the way from a program to robots: lose, delay and double messages.

A subclass takes bytes from the program's port, and calls `pass_on` for each whole message; answers
of robots are its own affair.
"""

import random
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial

from tetractl.core.clock import SECOND
from tetractl.core.errors import WireError
from tetractl.model.wheels import Counts
from tetractl_emulator.faults import ActingFaults
from tetractl_emulator.loop import Timeline
from tetractl_emulator.m3pi.robot import EmulatedRobot
from tetractl_emulator.port import PseudoPort, SerialDevice


class RobotRadio(SerialDevice):
    """A radio to robots that loses at least a given fraction of its transmissions.

    Args:
        timeline: The timeline of the emulation.
        port: The port of the radio.
        baud: Speed of the port [bits per second].
        note: Called with each command. None if no record is kept.
        robots: The robots.
        loss: Fraction of the transmissions that are lost.
        seed: Determines what is lost and late.
        acting: The faults that act now. None for none.
    """

    def __init__(
        self,
        timeline: Timeline,
        port: PseudoPort,
        baud: int,
        note: Callable[..., None] | None,
        robots: Sequence[EmulatedRobot],
        loss: float,
        seed: int,
        acting: ActingFaults | None = None,
    ) -> None:
        super().__init__(timeline, port, baud, note, acting)
        self.robots = robots
        self.sequence = 0  # of the last command, while another program drives the robots
        self._random = random.Random(seed)
        self._loss = loss

    def loss_to(self, robot: str | None = None) -> float:
        """Return the share of the transmissions that a robot, or the PC, does not receive."""
        deaf = self.acting.largest_share("deaf", robot) if robot else 0.0
        return max(self._loss, self.acting.largest_share("loss"), deaf)

    def late_ns(self) -> int:
        """Draw by how much a transmission is late [ns]."""
        late_s = self.acting.total_by("late_radio")
        for fault in self.acting.of_kind("overtaken_packets"):
            late_s += self._random.uniform(0, fault.by)
        return round(late_s * SECOND)

    @property
    def times(self) -> int:
        """How often robots receive each transmission."""
        return 2 if self.acting.of_kind("doubled_packets") else 1

    def pass_on(self, message: bytes, arrives_ns: int) -> None:
        """Deliver a message to each robot at a time or later, unless it is lost."""
        if self.acting.of_kind("driven_elsewhere"):
            with suppress(WireError):
                self.sequence = self._command(message.rstrip(b"\0\n"))["sequence"]
        arrives_ns += self.late_ns()
        for robot in self.robots:
            if self._random.random() >= self.loss_to(robot.name):
                hear = partial(robot.hear, message)
                for _ in range(self.times):
                    self._timeline.at(arrives_ns + robot.late_ns, hear)

    def stop_elsewhere(self, sequence: int) -> None:
        """Let the robots receive an emergency stop from another sender, with its own numbering.

        Nothing happens if such a stop cannot reach them.
        """

    def drive_elsewhere(self, sequence: int, counts: Counts) -> None:
        """Deliver a command of another program to the robots that have such a program."""

    def poll_answers(self) -> None:
        """Send the answers that robots have ready; to be called about every millisecond."""
        for robot in self.robots:
            if answer := robot.answer():
                self._answer(answer)
