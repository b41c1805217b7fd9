"""Whether poses and commands are of one recording: commands explain the motion that was seen, with
their sign and in their unit, and times of the two files are of one clock.

What commands explain of turns or ways is the share of their squares that a response to the commands
leaves no rest of. If it is small, one of other readings of the commands may explain more: reversed,
in another unit, by another clock. Else the commands are others than those that acted. What is seen
and what is sent must overlap, and robots must follow as late at the end as at the begin.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.core.errors import UsageError
from tetractl.core.poses import Floats

# ---- What commands explain ----

EXPLAINED = 0.4
"""Least share of the motion that commands explain if they are what they state. In 40 trials of the
emulated bench the directions that were sent explained .58 or more of the turning, others at most
.37."""
SURELY_MORE = 0.2
"""How much more of the motion another reading explains if the stated one is wrong: in those trials
.58 and .37 are .21 apart."""
REST_LEFT = 0.25
"""Where commands as stated explain too much for that: the share of what they leave unexplained that
another reading leaves at most. In a regular cycle, directions of a clock that was off explained .80
of the turning."""


@dataclass(frozen=True, slots=True)
class Reading:
    """What commands may be that they do not state: the `share` of the motion that they explain
    then, what is said of it, and what to do."""

    share: float
    said: str
    hint: str


def check_explained(
    source: str, what: str, share: float, least: float, readings: Sequence[Reading]
) -> None:
    """Raise UsageError if another reading explains surely more of `what` moved than the `share`
    that commands explain as stated, or if that is below `least`."""
    best = max(readings, key=lambda reading: reading.share)
    explains_enough = best.share >= EXPLAINED
    explains_more = best.share >= share + SURELY_MORE
    leaves_little = best.share >= 1 - REST_LEFT * (1 - share)
    is_better = best.share > share
    if is_better and explains_enough and (explains_more or leaves_little):
        raise UsageError(best.said, best.hint)
    if share < least:
        raise UsageError(
            f"{source}: the commands explain {max(share, 0.0):.0%} of the {what}",
            "are they another robot's, of another recording, or 10 s off? does it turn and drive?",
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
    """Return for how long both are [s], not above 0 if never."""
    return min(poses.end, commands.end) - max(poses.begin, commands.begin)


def refuse_times_apart(poses: Span, sent: Floats, commands: Span) -> None:
    """Raise UsageError if no command acts in the time of the poses; `sent` (C,) are the times of
    the commands [s], in order."""
    if _shared_s(poses, commands) <= 0:
        last = Span(commands.source, commands.begin, float(sent[-1]))
        raise UsageError(
            f"{last}: no time is among those of {poses}",
            "both files need times of one clock",
        )


COVERED = 0.9
"""Share of the robots' way while commands act, below which it is said; chosen."""
DIRECTIONS_MIN = 2
"""Number of commands in the time seen, below which it is said if there are more: the direction
hardly changes."""
COMMANDS_USUAL = 20
TIMES_AS_LONG = 100
"""It is said of fewer than COMMANDS_USUAL commands in the time seen, too, if all commands last more
than TIMES_AS_LONG the time seen; chosen, below the factor of 1000 between two units of time, as of
times in milliseconds that are said to be seconds."""


def clock_remark(poses: Span, sent: Floats, commands: Span, of_way: float) -> str | None:
    """Return what to say of commands that act while robots drive a share `of_way` of their way, or
    most of which act at other times; `sent` (C,) are their times [s], in order."""
    seen_s = poses.end - poses.begin
    if of_way < COVERED:
        shared_s = _shared_s(poses, commands)
        return f"{commands.source} covers {shared_s:.3g} s of the {seen_s:.3g} s of {poses.source}"
    count = len(sent)
    within = int(np.count_nonzero((sent >= poses.begin) & (sent < poses.end)))
    hardly_any_within = within < DIRECTIONS_MIN < count
    last_much_longer = float(np.ptp(sent)) > TIMES_AS_LONG * seen_s
    if hardly_any_within or (within < COMMANDS_USUAL and last_much_longer):
        are = "is" if within == 1 else "are"
        return (
            f"only {within} of the {count} times of {commands.source} {are} among the "
            f"{seen_s:.3g} s of {poses.source}: are they in s, as they say?"
        )
    return None
