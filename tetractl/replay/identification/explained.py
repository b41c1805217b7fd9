"""Whether commands explain the motion that was seen: with their sign, in their unit and time.

What commands explain of turns or ways is the share of their squares that a response to the commands
leaves no rest of. If it is small, one of other readings of the commands may explain more: reversed,
in another unit, by another clock. Else the commands are others than those that acted.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from tetractl.core.errors import UsageError

EXPLAINED = 0.4
"""Least share of the motion that commands explain if they are what they state."""
SURELY_MORE = 0.2
"""By how much more another reading of the commands explains if theirs is wrong. In 40 trials of
the emulated bench the directions that were sent explained .58 or more of the turning, others at
most .37."""


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
    if best.share >= max(EXPLAINED, share + SURELY_MORE):
        raise UsageError(best.said, best.hint)
    if share < least:
        raise UsageError(
            f"{source}: the commands explain {max(share, 0.0):.0%} of the {what}",
            "are they another robot's, of another recording, or 10 s off? does it turn and drive?",
        )
