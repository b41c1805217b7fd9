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


# ---- Times between poses ----

PAUSE_MAX_S = 86_400.0
"""Longest time without a pose in a recording [s]: a day."""


def refuse_pause(source: str, times: Floats) -> None:
    """Raise UsageError if the times (M,) of poses in order [s] are those of two clocks, or days."""
    if len(times) < 2:
        return
    pauses = np.diff(times)
    longest = int(pauses.argmax())
    if pauses[longest] > PAUSE_MAX_S:
        raise UsageError(
            f"{source}: between {times[longest]:.12g} and {times[longest + 1]:.12g} s there is no "
            "pose",
            "two recordings? number them in a column trial",
        )


APART_MAX_S = 0.5
"""Most time between two poses of robots on wheels that are of use [s]; chosen."""
COUNTED_MOST = 10
"""Most pictures from one pose to the next in a table that may count pictures; chosen."""
SMALLER = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Units in which times may be counted [s], the largest first."""
PICTURE_MIN = 2
"""Least number of such units between two poses if times may be in them: of milliseconds, 500
pictures a second; chosen."""


def refuse_sparse(source: str, times: Floats) -> None:
    """Raise UsageError if the times (M,) of a robot's poses are too far apart [s], as of times that
    are in a smaller unit, or count pictures."""
    gaps = np.diff(times)
    apart_s = float(np.median(gaps)) if len(gaps) else 0.0
    if apart_s <= APART_MAX_S:
        return
    hint = f"poses must be {APART_MAX_S:g} s apart at most"
    is_whole = bool((gaps == np.round(gaps)).all())
    if is_whole and apart_s <= COUNTED_MOST:
        hint += "; if its times count pictures, divide them by the pictures per second"
    units = [unit for unit, seconds in SMALLER.items() if apart_s * seconds <= APART_MAX_S]
    if units and apart_s >= PICTURE_MIN:
        hint += f"; if its times are in {units[0]}, name the column time_{units[0]}"
    raise UsageError(f"{source}: the poses of a robot are {apart_s:.3g} s apart", hint)


# ---- Rates of two clocks ----

DRIFT_MIN_S = 0.1
"""By how much earlier or later robots follow in the last third of a recording than in the first if
a clock is fast or slow [s]; chosen."""
DRIFT_COSTS = 0.1
"""By how much less of the motion commands explain in each of these thirds then, with the delay of
the other; chosen."""


def refuse_drift(source: str, shares: Floats, delays_s: Floats, apart_s: float) -> None:
    """Raise UsageError if the clock of commands is fast or slow.

    `shares` (3, D) are those of the motion in each third of a recording that commands explain after
    each of some delays (D,) [s]; from the first to the last it is `apart_s` [s].
    """
    first, middle, last = shares.argmax(axis=1).tolist()
    later_s = float(delays_s[last] - delays_s[first])
    of_first, _, of_last = shares
    drifts = abs(later_s) >= DRIFT_MIN_S
    drifts_steadily = min(first, last) <= middle <= max(first, last)
    each_is_explained = shares.max(axis=1).min() >= EXPLAINED
    first_needs_its_own = of_first[first] - of_first[last] >= DRIFT_COSTS
    last_needs_its_own = of_last[last] - of_last[first] >= DRIFT_COSTS
    delays_differ = first_needs_its_own and last_needs_its_own
    if not (drifts and drifts_steadily and each_is_explained and delays_differ):
        return
    rate = 1 - later_s / apart_s
    sooner = "sooner" if rate > 1 else "later"
    fast = f"{abs(rate - 1):.1%} {'fast' if rate > 1 else 'slow'}"
    raise UsageError(
        f"{source}: after {apart_s:.3g} s robots follow the commands {abs(later_s):.2g} s {sooner} "
        "than at first",
        f"is the clock of the commands about {fast}? divide its times by {rate:.4g}; or does a "
        "clock jump?",
    )
