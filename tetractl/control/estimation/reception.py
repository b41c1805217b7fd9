"""Detect a radio that is *sparse*: most of the directions that are sent reach no robot.

If all robots miss a direction, they continue to follow the previous one. A direction lost now and
then does no harm, because the next one comes a control period later. But if most directions are
lost, robots follow one direction for several periods, although it was planned for one.

The filters report, for each direction, how likely it is that a robot received it. Let Lambda_i be
the likelihood of robot i's frames if it received the direction, divided by their likelihood if it
missed the direction. Let q be the probability that a single robot misses a direction. Then the
frames of all robots are

    P = prod_i ((1 - q) Lambda_i + q)

times as likely if the radio sent the direction as if it did not. A working radio loses a direction
with the probability LOSS_IF_WORKING, a sparse one with the probability LOSS_IF_SPARSE. The test
keeps a score r. Each direction adds to r the logarithm of how much likelier its frames are with a
sparse radio:

    ln((LOSS_IF_SPARSE + (1 - LOSS_IF_SPARSE) P) / (LOSS_IF_WORKING + (1 - LOSS_IF_WORKING) P)).

The score does not fall below 0, because a radio may become sparse at any time (Page's test, 1954).
Only frames before the effect of the next direction count, because later frames show the next one.

Directions that act later than the filters assume also look as if they were missed. Two rules
distinguish them from a sparse radio. Late directions seem to be missed one after another, so only
the first few directions missed in a row count. And when r indicates a sparse radio for the first
time, the filters restart with all dead times; the radio is sparse if r indicates it once more.
"""

import math

import numpy as np

from tetractl.control.estimation.kernels.filter_state import (
    FOLLOWS,
    LOSS_PROBABILITY,
    Bank,
    SentCommands,
)
from tetractl.core.elementary import log, log_of_sum
from tetractl.core.poses import Floats, Integers

LOSS_IF_WORKING = 0.05
"""Assumed probability that a working radio loses a direction for all robots.

It is chosen equal to q of the module's docstring, which is `LOSS_PROBABILITY`.
"""
LOSS_IF_SPARSE = 0.75
"""Assumed probability that a sparse radio loses a direction: one in four gets through."""
LN_RATIO_SPARSE = 20.0
"""Value of the score r above which the test detects a sparse radio.

A direction that is missed adds at most 2.7, and a received one subtracts at most 1.3. Chosen.
"""
LN_PRODUCT_MIN = log(2)
"""Minimum absolute value of ln P with which a direction counts in the test.

Below it, the frames hardly show whether the direction was received. Chosen.
"""
MISSED_IN_A_ROW_MAX = 3
"""Maximum number of directions missed in a row that count in the test.

A radio that is silent for a while therefore adds at most 8.1 to the score r.
"""


class Reception:
    """The running test of one trial for a radio that loses most directions."""

    def __init__(self) -> None:
        self.ln_ratio = 0.0
        """The score r of the module's docstring, at least 0.

        A high score indicates a sparse radio.
        """
        self.times_detected = 0
        """Number of times that r exceeded LN_RATIO_SPARSE. Each time, r started again from 0."""
        self._missed_in_a_row = 0
        self._ln_robot_ratios: dict[int, Floats] = {}
        """ln((1 - q) Lambda + q) of each robot (N,), for each command not yet tested, by index.

        A robot's value is taken at the last frame before the next command took effect on it. It is
        0 if there was no such frame.
        """
        self._next_command = 1
        """Index of the next command to be tested. Command 0 is not, because none precedes it."""

    @property
    def is_sparse(self) -> bool:
        """Whether the radio is sparse.

        The test must have detected this twice: the second time after the filters restarted with
        all dead times.
        """
        return self.times_detected > 1

    def add_frame(self, bank: Bank, filters: Integers, commands: SentCommands) -> None:
        """Record what a frame shows about the reception of the last command that took effect.

        A command is tested once the next command has taken effect on all robots, provided that it
        `is_testable` and that frames were taken before.

        Args:
            bank: The filters, which have followed the robots to this frame.
            filters: The rows of the robots' likeliest filters (N,).
            commands: The commands that were sent.
        """
        rows = filters.tolist()
        acted_last = [int(bank.next_command[row, robot]) - 1 for robot, row in enumerate(rows)]
        for robot, (row, command) in enumerate(zip(rows, acted_last, strict=True)):
            if command < self._next_command:  # tested already, by a filter with a shorter dead time
                continue
            ln_ratios = self._ln_robot_ratios.setdefault(command, np.zeros(len(rows)))
            ln_ratios[robot] = ln_robot_ratio(bank, row, robot, commands.directions[command])
        first_untested = max(self._next_command, min(acted_last))
        for command in range(self._next_command, first_untested):
            ln_ratios = self._ln_robot_ratios.pop(command, None)
            if ln_ratios is not None and is_testable(commands.directions, command):
                self.add_direction(float(ln_ratios.sum()))
        self._next_command = first_untested

    def add_direction(self, ln_product: float) -> None:
        """Update the score r with one direction, given the logarithm of its likelihood ratio P.

        The direction is ignored if the frames hardly show whether it was received, or if more than
        MISSED_IN_A_ROW_MAX directions seem to be missed in a row. If r exceeds LN_RATIO_SPARSE, it
        starts again from 0, and `times_detected` grows by one.
        """
        if abs(ln_product) < LN_PRODUCT_MIN:
            return
        if ln_product > 0:
            self._missed_in_a_row = 0
        else:
            self._missed_in_a_row += 1
        if self._missed_in_a_row > MISSED_IN_A_ROW_MAX:
            return
        ln_if_often = log_of_sum(log(LOSS_IF_SPARSE), log(1 - LOSS_IF_SPARSE) + ln_product)
        ln_if_seldom = log_of_sum(log(LOSS_IF_WORKING), log(1 - LOSS_IF_WORKING) + ln_product)
        self.ln_ratio = max(0.0, self.ln_ratio + ln_if_often - ln_if_seldom)
        if self.ln_ratio > LN_RATIO_SPARSE:
            self.ln_ratio = 0.0
            self.times_detected += 1


def is_testable(directions: Floats, command: int) -> bool:
    """Check whether frames can show if robots received a command.

    This is possible if the robots drive under both this command and the previous one, and if the
    new direction differs from all directions that they may still be following.

    Args:
        directions: The directions of all commands [rad]. NaN for a stop.
        command: Index of the command.
    """
    previous = directions[max(0, command - FOLLOWS) : command]
    direction = directions[command]
    both_drive = not np.isnan([previous[-1], direction]).any()
    return bool(both_drive and direction not in previous)


def ln_robot_ratio(bank: Bank, row: int, robot: int, direction: float) -> float:
    """Compute ln((1 - q) Lambda + q): how much one robot's motion supports missed commands.

    When the last command took effect, the odds that the robot received it were (1 - q) / q. Since
    then, frames have multiplied these odds by Lambda. The present odds are the probability of the
    likeliest hypothesis that follows the direction, divided by the probability of the likeliest one
    that follows another direction. If either of the two is missing, or if the robot is most
    probably stuck, nothing is known, and the result is 0.

    Args:
        bank: The filters.
        row: The row of the filter in the bank.
        robot: The index of the robot.
        direction: The direction of the command that took effect last [rad].
    """
    # as lists: NumPy takes ten times as long for four numbers
    *ln_weights, ln_stuck = bank.ln_weight[row, robot].tolist()
    if ln_stuck > max(ln_weights):
        return 0.0
    ln_received = -math.inf
    ln_missed = -math.inf
    for ln_weight, followed in zip(ln_weights, bank.direction[row, robot].tolist(), strict=False):
        if followed == direction:
            ln_received = max(ln_received, ln_weight)
        else:
            ln_missed = max(ln_missed, ln_weight)
    if math.isinf(ln_received) or math.isinf(ln_missed):
        return 0.0
    return log(LOSS_PROBABILITY) + log_of_sum(0.0, ln_received - ln_missed)
