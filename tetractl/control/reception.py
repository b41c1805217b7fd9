"""Whether a radio lets through only few of the directions that are sent.

A direction that all robots miss leaves them on the one before. One lost now and then does no harm,
as the next one comes a control period later. But if most are lost, robots follow for several
periods what was searched to be followed for one.

The filters say of each direction how likely it is that a robot heard it. Let Lambda_i be the
likelihood of robot i's frames if it heard the direction, over that if it missed it, and q the
probability that a robot misses one by itself. Then the frames of all robots are

    P = prod_i ((1 - q) Lambda_i + q)

times as likely if the radio let the direction through as if it did not. Let the probability that it
does not be SELDOM for a radio that works, and OFTEN for one that lets few through. The frames so
far are exp(r) times as likely with the latter, where each direction adds to r

    ln((OFTEN + (1 - OFTEN) P) / (SELDOM + (1 - SELDOM) P)),

and r is kept at 0 or above, as a radio may change at any time (Page's test, 1954). Of a direction,
the frames count that were taken before the next one acted: later ones, in which robots turn by the
next one, would speak for or against both.

Directions that act later than the filters know seem to be missed, too. Two things tell them from
those of a sparse radio. They are missed one after another, so of directions missed in a row only
the first few count. And when r shows a sparse radio for the first time, the filters begin again
with all dead times: the radio is sparse if r shows it once more.
"""

import math

import numpy as np

from tetractl.control.kernels.filter_state import ASSUMED, Bank, SentCommands
from tetractl.core.poses import Floats, Integers

SELDOM = 0.05
"""Probability that a radio that works lets a direction not through; as `ASSUMED.lost`, that a robot
misses one."""
OFTEN = 0.75
"""The same of a radio that lets few through: one in four."""
LN_SURE = 20.0
"""r above which few are let through for certain. One missed direction adds 2.7 at most, and one
that is heard takes 1.3. Chosen."""
LN_SAYS = math.log(2)
"""Least absolute value of ln P with which a direction counts: else the frames hardly say whether it
was heard. Chosen."""
MISSED_IN_A_ROW = 3
"""Number of directions missed in a row that count: a silence of the radio adds 8.1 at most."""


class Reception:
    """The test in one trial."""

    def __init__(self, robots: int) -> None:
        self.ln_ratio = 0.0
        """r of the module."""
        self.times_shown = 0
        """How often r has been above LN_SURE; it began at 0 again each time."""
        self._missed_in_a_row = 0
        self._robots = robots
        self._ln_robot_ratios: dict[int, Floats] = {}
        """Of the commands that are the last to have acted on some robot, by their index, what the
        frames of each robot have said so far: ln((1 - q) Lambda + q), (N,)."""
        self._next = 1
        """Index of the next command to be tested. The first has none before it."""

    @property
    def is_sparse(self) -> bool:
        """Whether few directions are let through, by filters that had all dead times."""
        return self.times_shown > 1

    def add_frame(self, bank: Bank, filters: Integers, commands: SentCommands) -> None:
        """Take what a frame says of the commands that acted last, after the filters have followed
        the robots to it; `filters` (N,) are the robots' likeliest ones.

        A command is tested once the next one has acted on all robots.
        """
        rows = filters.tolist()
        acted_last = [int(bank.next_command[row, robot]) - 1 for robot, row in enumerate(rows)]
        for robot, row in enumerate(rows):
            command = acted_last[robot]
            if command < self._next:
                continue
            ln_ratios = self._ln_robot_ratios.setdefault(command, np.zeros(self._robots))
            ln_ratios[robot] = ln_robot_ratio(bank, row, robot, commands.directions[command])
        first_untested = max(self._next, min(acted_last))
        for command in range(self._next, first_untested):
            ln_ratios = self._ln_robot_ratios.pop(command, None)
            if ln_ratios is not None and is_news(commands.directions, command):
                self.add_direction(float(ln_ratios.sum()))
        self._next = first_untested

    def add_direction(self, ln_product: float) -> None:
        """Add a direction with ln P to the test."""
        if abs(ln_product) < LN_SAYS:
            return
        if ln_product > 0:
            self._missed_in_a_row = 0
        else:
            self._missed_in_a_row += 1
        if self._missed_in_a_row > MISSED_IN_A_ROW:
            return
        ln_if_often = np.logaddexp(math.log(OFTEN), math.log(1 - OFTEN) + ln_product)
        ln_if_seldom = np.logaddexp(math.log(SELDOM), math.log(1 - SELDOM) + ln_product)
        self.ln_ratio = max(0.0, self.ln_ratio + float(ln_if_often - ln_if_seldom))
        if self.ln_ratio > LN_SURE:
            self.ln_ratio = 0.0
            self.times_shown += 1


def is_news(directions: Floats, command: int) -> bool:
    """Return whether a command's direction differs from that before, and robots are not to stand in
    either: else frames do not show whether they heard it."""
    before, tested = directions[command - 1 : command + 1]
    both_drive = not np.isnan([before, tested]).any()
    return bool(both_drive and before != tested)


def ln_robot_ratio(bank: Bank, row: int, robot: int, direction: float) -> float:
    """Return ln((1 - q) Lambda + q) of a robot and the direction of the command that acted last, by
    a filter of the robot, a row of the bank.

    As the command branched hypotheses with the probability q that it was missed, the odds of those
    that heard it, over those that did not, are Lambda (1 - q) / q. The result is 0 if only one of
    both is kept, or if the robot is stuck: then nothing is known.
    """
    ln_weight = bank.ln_weight[row, robot]
    stuck = len(ln_weight) - 1
    if ln_weight.argmax() == stuck:
        return 0.0
    drives = np.arange(len(ln_weight)) < stuck
    follows_it = bank.direction[row, robot] == direction
    ln_heard = ln_weight[drives & follows_it].max(initial=-np.inf)
    ln_missed = ln_weight[drives & ~follows_it].max(initial=-np.inf)
    if np.isinf(ln_heard) or np.isinf(ln_missed):
        return 0.0
    return math.log(ASSUMED.lost) + float(np.logaddexp(0.0, ln_heard - ln_missed))
