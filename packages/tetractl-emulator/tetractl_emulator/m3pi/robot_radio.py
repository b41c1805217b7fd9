"""Base class of all emulated radios, which can lose, delay and duplicate transmissions.

A subclass receives bytes from the program's port, and calls `pass_on` for each complete message. It
also handles the robots' answers.
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
    """A radio to robots that loses at least the fraction `loss` of its transmissions.

    Args:
        timeline: The emulation's timeline.
        port: The port at which a program sends.
        baud: Speed of the port [bits/s].
        note: Records an event, called as `note(event, **facts)`. None if there is no record.
        robots: The robots that receive the messages.
        loss: Minimum probability that a transmission is lost.
        seed: Seed of what is lost or late.
        acting: The faults that act now. None if there are none.
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
        """Return the probability that a transmission is lost.

        Args:
            robot: Name of the receiving robot. None if the PC receives.
        """
        deaf = self.acting.largest_share("deaf", robot) if robot else 0.0
        return max(self._loss, self.acting.largest_share("loss"), deaf)

    def late_ns(self) -> int:
        """Sample the additional delay of a transmission [ns], which faults cause.

        It is 0 if no such fault acts.
        """
        late_s = self.acting.total_by("late_radio")
        for fault in self.acting.of_kind("overtaken_packets"):
            late_s += self._random.uniform(0, fault.by)
        return round(late_s * SECOND)

    @property
    def times(self) -> int:
        """Number of times that a robot receives each transmission.

        It is 2 during the fault `doubled_packets`, otherwise 1.
        """
        return 2 if self.acting.of_kind("doubled_packets") else 1

    def pass_on(self, message: bytes, arrives_ns: int) -> None:
        """Deliver a message to each robot, unless it is lost.

        Args:
            message: The message.
            arrives_ns: Time of arrival without additional delays [ns].
        """
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
        """Let the robots receive an emergency stop, as if from another program.

        By default, nothing happens: override this method if another program could send such a stop.

        Args:
            sequence: Sequence number of the stop.
        """

    def drive_elsewhere(self, sequence: int, counts: Counts) -> None:
        """Let the robots receive a driving command, as if from another program.

        By default, nothing happens: override this method if another program could send commands.

        Args:
            sequence: Sequence number of the command.
            counts: Counts of the left and the right motor of each robot.
        """

    def poll_answers(self) -> None:
        """Send the answers that robots have ready. To be called about every millisecond.

        Robots that are switched off have none.
        """
        for robot in self.robots:
            if answer := robot.answer():
                self._answer(answer)
