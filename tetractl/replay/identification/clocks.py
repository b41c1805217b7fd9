"""Whether times of two files are those of one clock: what is seen and what is sent must overlap."""

from dataclasses import dataclass

import numpy as np

from tetractl.core.errors import UsageError
from tetractl.core.poses import Floats

COVERED = 0.9
"""Share of the robots' way while commands act, below which it is said."""
WITHIN = 2
"""Number of commands in the time seen, below which it is said: the direction hardly changes."""

APART_MAX_S = 0.5
"""Most time between two poses of robots on wheels that are of use [s]."""
SMALLER = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Units in which times may be counted [s]."""


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
    if within < WITHIN < len(sent):
        return (
            f"only {within} of the {len(sent)} times of {commands.source} is among the "
            f"{length:.3g} s of {poses.source}: are they in s, as they say?"
        )
    return None


def refuse_sparse(source: str, apart_s: float) -> None:
    """Raise UsageError if poses are too far apart, as of times that are in a smaller unit."""
    if apart_s <= APART_MAX_S:
        return
    units = [unit for unit, seconds in SMALLER.items() if apart_s * seconds <= APART_MAX_S]
    hint = f"poses must be {APART_MAX_S:g} s apart at most"
    if units:
        hint += f"; if its times are in {units[0]}, name the column time_{units[0]}"
    raise UsageError(f"{source}: the poses of a robot are {apart_s:.3g} s apart", hint)
