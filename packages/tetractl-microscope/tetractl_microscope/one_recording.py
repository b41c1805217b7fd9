"""Checks that a file of poses and a file of commands belong to the same recording.

The commands must explain the observed motion, with their sign and in their unit, and the times of
both files must come from the same clock.

The fraction of turns or distances that commands explain is the fraction of their squares that
disappears if a response to the commands is subtracted. If this fraction is small, another reading
of the commands may explain more: reversed, in another unit, or on another clock. If no reading
explains more, other commands acted. The times of poses and commands must overlap, and the delay of
the robots must be the same at the end as at the beginning.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.core.errors import UsageError
from tetractl.core.poses import Floats

# ---- Motion that the commands explain ----

EXPLAINED_FRACTION_MIN = 0.4
"""Minimum fraction of the motion that the commands of a recording explain.

In 40 trials of the emulated bench, the directions that were sent explained at least .58 of the
turning, and directions of other trials at most .37.
"""
EXPLAINED_GAIN_MIN = 0.2
"""Minimum additional fraction of the motion that a reading explains if the stated one is wrong.

In the trials above, .58 and .37 are .21 apart.
"""
UNEXPLAINED_RATIO_MAX = 0.25
"""Maximum motion that another reading leaves unexplained, as a fraction of the stated reading's.

This limit is needed if the stated commands explain too much for the limits above. In a regular
cycle, directions from a wrong clock explained .80 of the turning.
"""


@dataclass(frozen=True, slots=True)
class Reading:
    """Another interpretation of commands that could explain the motion.

    Attributes:
        fraction: Fraction of the motion that this reading explains.
        message: The error message if this reading explains more than the stated commands.
        hint: The hint of this error: what the user should do.
    """

    fraction: float
    message: str
    hint: str


def check_explained(
    source: str, motion_name: str, fraction: float, fraction_min: float, readings: Sequence[Reading]
) -> None:
    """Check that no other reading of the commands explains the motion better than the stated one.

    Args:
        source: The file of the commands.
        motion_name: Name of the motion that was compared, for the message.
        fraction: Fraction of the motion that the stated commands explain.
        fraction_min: Minimum fraction that they must explain.
        readings: The other readings.

    Raises:
        UsageError: If another reading explains certainly more, or if `fraction` is below
            `fraction_min`.
    """
    best = max(readings, key=lambda reading: reading.fraction)
    explains_enough = best.fraction >= EXPLAINED_FRACTION_MIN
    explains_more = best.fraction >= fraction + EXPLAINED_GAIN_MIN
    leaves_little = best.fraction >= 1 - UNEXPLAINED_RATIO_MAX * (1 - fraction)
    is_better = best.fraction > fraction
    if is_better and explains_enough and (explains_more or leaves_little):
        raise UsageError(best.message, best.hint)
    if fraction < fraction_min:
        raise UsageError(
            f"{source}: the commands explain only {max(fraction, 0.0):.0%} of the {motion_name}",
            "check that the commands belong to this robot and this recording, that both files use "
            "the same clock, and that the robot turns and drives",
        )


# ---- Times of poses and commands ----


@dataclass(frozen=True, slots=True)
class FileSpan:
    """The time range that a file covers.

    Attributes:
        source: The file.
        begin_s: Its first time [s].
        end_s: Its last time [s].
    """

    source: str
    begin_s: float
    end_s: float

    def __str__(self) -> str:
        return f"{self.source}, {self.begin_s:.12g} to {self.end_s:.12g} s"


def _overlap_s(poses: FileSpan, commands: FileSpan) -> float:
    """Compute for how long the time ranges of poses and commands overlap [s].

    If there is a gap between the two, the result is the gap's length with a negative sign.
    """
    return min(poses.end_s, commands.end_s) - max(poses.begin_s, commands.begin_s)


def refuse_times_apart(poses: FileSpan, times: Floats, commands: FileSpan) -> None:
    """Check that at least one command acted while poses were recorded.

    Args:
        poses: When poses were recorded.
        times: Times of the commands [s], in order, shape (C,).
        commands: When commands acted.

    Raises:
        UsageError: If the times do not overlap.
    """
    if _overlap_s(poses, commands) <= 0:
        commands_span = FileSpan(commands.source, commands.begin_s, float(times[-1]))
        raise UsageError(
            f"{commands_span}: no time in this file is within the times of {poses}",
            "the times in both files must come from the same clock",
        )


COVERED_FRACTION_MIN = 0.9
"""Minimum fraction of the robots' path that commands should cover. Below it, a remark is printed.

The value is chosen, not measured.
"""
COMMANDS_WITHIN_MIN = 2
"""Minimum number of commands during the recording.

If there are fewer, but more commands outside the recording, a warning is printed.
"""
COMMANDS_WITHIN_USUAL = 20  # a recording with fewer commands may be on another clock
DURATION_RATIO_MAX = 100
"""Maximum ratio of the duration of all commands to the duration of the recording.

Above it, a warning appears if there are fewer than COMMANDS_WITHIN_USUAL commands during the
recording. The ratio is below the factor of 1000 between two units of time: milliseconds may have
been given as seconds.
"""


def describe_clock_mismatch(
    poses: FileSpan, times: Floats, commands: FileSpan, covered_fraction: float
) -> str | None:
    """Describe how the commands of a recording seem to come from another clock than its poses.

    Args:
        poses: When poses were recorded.
        times: Times of the commands [s], in order, shape (C,).
        commands: When commands acted.
        covered_fraction: Fraction of the robots' path during which a command acts.

    Returns:
        A remark for the user. None if the clocks seem to be the same.
    """
    recording_s = poses.end_s - poses.begin_s
    if covered_fraction < COVERED_FRACTION_MIN:
        overlap_s = _overlap_s(poses, commands)
        return (
            f"{commands.source} covers only {overlap_s:.3g} s of the {recording_s:.3g} s of "
            f"{poses.source}"
        )
    n_commands = len(times)
    n_within = int(np.count_nonzero((times >= poses.begin_s) & (times < poses.end_s)))
    are_few_within = n_within < COMMANDS_WITHIN_MIN < n_commands
    command_span_is_far_longer = float(np.ptp(times)) > DURATION_RATIO_MAX * recording_s
    if are_few_within or (n_within < COMMANDS_WITHIN_USUAL and command_span_is_far_longer):
        verb = "is" if n_within == 1 else "are"
        return (
            f"only {n_within} of the {n_commands} times of {commands.source} {verb} within the "
            f"{recording_s:.3g} s of {poses.source}: are the times in seconds, as their column "
            "says?"
        )
    return None
