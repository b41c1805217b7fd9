"""Base class of all emulated radios, which can lose, delay and duplicate transmissions.

A subclass receives bytes from the program's port, and calls `deliver` for each complete message. It
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
    """Base class of emulated radios, which deliver messages to robots with losses and delays.

    Args:
        timeline: The emulation's timeline.
        port: The port at which a program sends.
        baud: Speed of the port [bits/s].
        note: Records an event, called as `note(event, **facts)`. None if there is no record.
        robots: The robots that receive the messages.
        loss: Minimum probability that a transmission is lost.
        seed: Seed of the random losses and delays.
        acting: The faults that act now. None if no fault can act.

    Attributes:
        robots: The robots that receive the messages.
        sequence: Sequence number of our program's newest command while another program drives the
            robots.
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
        self.sequence = 0
        self._random = random.Random(seed)
        self._loss = loss

    def loss_probability(self, robot: str | None = None) -> float:
        """Compute the probability that a transmission is lost.

        Args:
            robot: Name of the receiving robot. None if the PC receives.
        """
        deaf_share = self.acting.largest_share("deaf", robot) if robot else 0.0
        return max(self._loss, self.acting.largest_share("loss"), deaf_share)

    def sample_delay_ns(self) -> int:
        """Sample the additional delay that faults cause for a transmission [ns].

        The delay is 0 if no such fault acts.
        """
        delay_s = self.acting.total_by("late_radio")
        for fault in self.acting.of_kind("overtaken_packets"):
            delay_s += self._random.uniform(0, fault.by)
        return round(delay_s * SECOND)

    @property
    def times(self) -> int:
        """Number of times that a robot receives each transmission.

        It is 2 during the fault `doubled_packets`, otherwise 1.
        """
        return 2 if self.acting.of_kind("doubled_packets") else 1

    def deliver(self, message: bytes, arrival_ns: int) -> None:
        """Deliver a message to each robot, unless it is lost.

        Args:
            message: The message.
            arrival_ns: Time of arrival without additional delays [ns].
        """
        if self.acting.of_kind("driven_elsewhere"):
            with suppress(WireError):
                self.sequence = self._decode_command(message.rstrip(b"\0\n"))["sequence"]
        arrival_ns += self.sample_delay_ns()
        for robot in self.robots:
            if self._random.random() >= self.loss_probability(robot.name):
                receive_message = partial(robot.receive, message)
                for _ in range(self.times):
                    self._timeline.at(arrival_ns + robot.late_ns, receive_message)

    def stop_from_other_program(self, sequence: int) -> None:
        """Let the robots receive an emergency stop, as if from another program.

        By default, nothing happens: override this method if another program could send such a stop.

        Args:
            sequence: Sequence number of the stop.
        """

    def drive_from_other_program(self, sequence: int, counts: Counts) -> None:
        """Let the robots receive a driving command, as if from another program.

        By default, nothing happens: override this method if another program could send commands.

        Args:
            sequence: Sequence number of the command.
            counts: Counts of the left and the right motor of each robot.
        """

    def poll_answers(self) -> None:
        """Send the robots' waiting answers to the program. To be called about every millisecond.

        Robots that are switched off do not answer.
        """
        for robot in self.robots:
            if answer := robot.answer():
                self._send_to_program(answer)
