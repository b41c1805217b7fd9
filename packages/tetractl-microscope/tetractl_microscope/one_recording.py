"""Checks that poses and commands belong to the same recording.

The commands must explain the motion that was seen, with their sign and in their unit, and the times
of both files must come from the same clock.

The fraction of turns or distances that commands explain is the fraction of their squares that
disappears if a response to the commands is subtracted. If it is small, another reading of the
commands may explain more: reversed, in another unit, or on another clock. Otherwise, other commands
acted. The times of poses and commands must overlap, and robots must follow as late at the end as at
the beginning.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.core.errors import UsageError
from tetractl.core.poses import Floats

# ---- What commands explain ----

EXPLAINED = 0.4
"""Minimum fraction of the motion that commands explain if they are what they claim to be.

In 40 trials of the emulated bench, the directions that were sent explained at least .58 of the
turning, others at most .37.
"""
SURELY_MORE = 0.2
"""How much more of the motion another reading explains if the stated one is wrong.

In the trials above, .58 and .37 are .21 apart.
"""
REST_LEFT = 0.25
"""Maximum unexplained fraction that another reading leaves, of what the stated reading leaves.

This is used if the stated commands explain too much for the limits above. In a regular cycle,
directions from a wrong clock explained .80 of the turning.
"""


@dataclass(frozen=True, slots=True)
class Reading:
    """Another interpretation of commands that could explain the motion.

    Attributes:
        fraction: Fraction of the motion that it explains.
        message: The error message if it explains more than the stated commands.
        hint: What to do then.
    """

    fraction: float
    message: str
    hint: str


def check_explained(
    source: str, what: str, fraction: float, fraction_min: float, readings: Sequence[Reading]
) -> None:
    """Check that no other reading explains the motion better than the stated one.

    Args:
        source: The file of the commands.
        what: What was compared, for the message.
        fraction: Fraction of the motion that the stated commands explain.
        fraction_min: Minimum fraction that they must explain.
        readings: The other readings.

    Raises:
        UsageError: If another reading explains certainly more, or if `fraction` is below
            `fraction_min`.
    """
    best = max(readings, key=lambda reading: reading.fraction)
    explains_enough = best.fraction >= EXPLAINED
    explains_more = best.fraction >= fraction + SURELY_MORE
    leaves_little = best.fraction >= 1 - REST_LEFT * (1 - fraction)
    is_better = best.fraction > fraction
    if is_better and explains_enough and (explains_more or leaves_little):
        raise UsageError(best.message, best.hint)
    if fraction < fraction_min:
        raise UsageError(
            f"{source}: the commands explain only {max(fraction, 0.0):.0%} of the {what}",
            "do the commands belong to another robot or recording, or are their times"
            " 10 s off? Does the robot turn and drive at all?",
        )


# ---- Times of poses and commands ----


@dataclass(frozen=True, slots=True)
class Span:
    """The times of a file, from `begin` to `end` [s]."""

    source: str
    begin: float
    end: float

    def __str__(self) -> str:
        return f"{self.source}, {self.begin:.12g} to {self.end:.12g} s"


def _shared_s(poses: Span, commands: Span) -> float:
    """Compute for how long both time spans overlap [s].

    If there is a gap between them, the result is the gap's length with a negative sign.
    """
    return min(poses.end, commands.end) - max(poses.begin, commands.begin)


def refuse_times_apart(poses: Span, times: Floats, commands: Span) -> None:
    """Check that at least one command acts while poses were recorded.

    Args:
        poses: When poses were recorded.
        times: Times of the commands [s], in order, shape (C,).
        commands: When commands acted.

    Raises:
        UsageError: If no command does.
    """
    if _shared_s(poses, commands) <= 0:
        commands_span = Span(commands.source, commands.begin, float(times[-1]))
        raise UsageError(
            f"{commands_span}: no time in this file is within the times of {poses}",
            "the times in both files must come from the same clock",
        )


COVERED_MIN = 0.9
"""Fraction of the robots' path under commands below which a remark reports it.

The value is chosen, not measured.
"""
DIRECTIONS_MIN = 2
"""Minimum number of commands during the recording.

Below it, a warning says that the direction hardly changes, if there are more commands outside the
recording.
"""
COMMANDS_WITHIN_USUAL = 20
DURATION_RATIO_MAX = 100
"""Maximum ratio of all commands' duration to the recording's, if it has few commands.

Above it, a warning also appears for fewer than COMMANDS_WITHIN_USUAL commands during the recording.
It is chosen below the factor of 1000 between two units of time, for example if milliseconds are
given as seconds.
"""


def clock_remark(poses: Span, times: Floats, commands: Span, covered_fraction: float) -> str | None:
    """Return a remark if commands seem to come from another clock. None if they do not.

    Args:
        poses: When poses were recorded.
        times: Times of the commands [s], in order, shape (C,).
        commands: When commands acted.
        covered_fraction: Fraction of the robots' path during which a command acts.
    """
    seen_s = poses.end - poses.begin
    if covered_fraction < COVERED_MIN:
        shared_s = _shared_s(poses, commands)
        return (
            f"{commands.source} covers only {shared_s:.3g} s of the {seen_s:.3g} s of "
            f"{poses.source}"
        )
    n_commands = len(times)
    n_within = int(np.count_nonzero((times >= poses.begin) & (times < poses.end)))
    are_few_within = n_within < DIRECTIONS_MIN < n_commands
    last_far_longer = float(np.ptp(times)) > DURATION_RATIO_MAX * seen_s
    if are_few_within or (n_within < COMMANDS_WITHIN_USUAL and last_far_longer):
        verb = "is" if n_within == 1 else "are"
        return (
            f"only {n_within} of the {n_commands} times of {commands.source} {verb} within the "
            f"{seen_s:.3g} s of {poses.source}: are the times in seconds, as their column says?"
        )
    return None
