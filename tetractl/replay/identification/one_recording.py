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

EXPLAINED = 0.4
"""Least share of the motion that commands explain if they are what they state."""
SURELY_MORE = 0.2
"""By how much more another reading of the commands explains if theirs is wrong. In 40 trials of
the emulated bench the directions that were sent explained .58 or more of the turning, others at
most .37."""
REST = 0.25
"""Or what share of the rest that the commands leave as stated."""
COVERED = 0.9
"""Share of the robots' way while commands act, below which it is said."""
WITHIN = 2
"""Number of commands in the time seen, below which it is said: the direction hardly changes."""
RARE = 20
LONG = 100
"""Number of commands in the time seen, below which it is said if all last LONG times as long."""
APART_MAX_S = 0.5
"""Most time between two poses of robots on wheels that are of use [s]."""
PAUSE_MAX_S = 86_400.0
"""Longest time without a pose in a recording [s]: a day."""
SMALLER = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Units in which times may be counted [s]."""
COUNTED_MOST = 10
"""Most pictures between two poses of a table that counts pictures."""
PICTURE_MS = 2
"""Least milliseconds between two poses."""
DRIFT_LEAST_S = 0.1
DRIFT_COSTS = 0.1
"""By how much robots follow later in the last third of a recording than in the first if a clock is
fast or slow [s]; and by how much less of the motion commands explain in each with the other's."""


# ---- What commands explain ----


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
    surely = min(share + SURELY_MORE, 1 - REST * (1 - share))
    if best.share >= max(EXPLAINED, surely) and best.share > share:
        raise UsageError(best.said, best.hint)
    if share < least:
        raise UsageError(
            f"{source}: the commands explain {max(share, 0.0):.0%} of the {what}",
            "are they another robot's, of another recording, or 10 s off? does it turn and drive?",
        )


# ---- Clocks ----


@dataclass(frozen=True, slots=True)
class Span:
    """The times of a file, from `begin` to `end` [s]."""

    source: str
    begin: float
    end: float

    def __str__(self) -> str:
        return f"{self.source}, {self.begin:.12g} to {self.end:.12g} s"


def clock_remark(poses: Span, sent: Floats, commands: Span, of_way: float) -> str | None:
    """Return what to say of commands that act while robots drive a share `of_way` of their way, or
    most of which act at other times; `sent` (C,) are their times [s], in order. UsageError if none
    acts in the time of the poses.
    """
    covered = min(poses.end, commands.end) - max(poses.begin, commands.begin)
    if covered <= 0:
        last = Span(commands.source, commands.begin, float(sent[-1]))
        raise UsageError(
            f"{last}: no time is among those of {poses}",
            "both files need times of one clock",
        )
    length = poses.end - poses.begin
    within = int(np.count_nonzero((sent >= poses.begin) & (sent < poses.end)))
    if of_way < COVERED:
        return f"{commands.source} covers {covered:.3g} s of the {length:.3g} s of {poses.source}"
    are_rare = within < RARE and float(np.ptp(sent)) > LONG * length
    if within < WITHIN < len(sent) or are_rare:
        are = "is" if within == 1 else "are"
        return (
            f"only {within} of the {len(sent)} times of {commands.source} {are} among the "
            f"{length:.3g} s of {poses.source}: are they in s, as they say?"
        )
    return None


def refuse_pause(source: str, times: Floats) -> None:
    """Raise UsageError if the times (M,) of poses in order [s] are those of two clocks, or days."""
    pauses = np.diff(times)
    row = int(pauses.argmax()) if len(pauses) else 0
    if len(pauses) and pauses[row] > PAUSE_MAX_S:
        raise UsageError(
            f"{source}: between {times[row]:.12g} and {times[row + 1]:.12g} s there is no pose",
            "two recordings? number them in a column trial",
        )


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
    if units and apart_s >= PICTURE_MS:
        hint += f"; if its times are in {units[0]}, name the column time_{units[0]}"
    raise UsageError(f"{source}: the poses of a robot are {apart_s:.3g} s apart", hint)


def refuse_drift(source: str, shares: Floats, delays_s: Floats, apart_s: float) -> None:
    """Raise UsageError if the clock of commands is fast or slow.

    `shares` (3, D) are those of the motion in each third of a recording that commands explain after
    each of some delays (D,) [s]; from the first to the last it is `apart_s` [s].
    """
    first, middle, last = shares.argmax(axis=1).tolist()
    least = min(shares[0, first] - shares[0, last], shares[2, last] - shares[2, first])
    is_explained = shares.max(axis=1).min() >= EXPLAINED
    later_s = float(delays_s[last] - delays_s[first])
    is_between = min(first, last) <= middle <= max(first, last)
    if abs(later_s) < DRIFT_LEAST_S or least < DRIFT_COSTS or not (is_explained and is_between):
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
