"""Shrinks the plan of a day that broke an invariant to the few events that matter.

A greedy delta debugger: it tries each fault alone, leaves out faults one by one, then parts of the
world, and keeps each change after which the same invariant is still broken. It ends after
`PLAYS_MAX` plays, or when their virtual time is `SHRINKS_S`: neither is a matter of the computer's
speed.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

from tetractl_emulator.rehearsal.day import DayPlan

PLAYS_MAX = 40  # most plays of a day
SHRINKS_S = 600.0  # longest time that a day is shrunk

Breaks = Callable[[DayPlan], tuple[bool, float]]
"""Plays a plan; returns whether the invariant is broken, and the virtual time that it took [s]."""


def shrunk(plan: DayPlan, breaks: Breaks) -> tuple[DayPlan, int]:
    """Return the smallest plan found, which breaks the same invariant, and the number of plays."""
    plays = 0
    took_s = 0.0
    changed = True
    while changed:
        changed = False
        for smaller in _smaller(plan):
            if plays == PLAYS_MAX or took_s >= SHRINKS_S:
                break
            still, seconds = breaks(smaller)
            plays += 1
            took_s += seconds
            if still:
                plan = smaller
                changed = True
                break
    return plan, plays


def _smaller(plan: DayPlan) -> Iterator[DayPlan]:
    """Yield simpler plans, those that leave out most first."""
    if len(plan.faults) > 2:
        yield from (replace(plan, faults=[fault]) for fault in plan.faults)
    for i in range(len(plan.faults)):
        yield replace(plan, faults=[*plan.faults[:i], *plan.faults[i + 1 :]])
    if plan.settings:
        yield replace(plan, settings=())
    if len(plan.emulation) > 1:
        yield replace(plan, emulation={})
    for key in plan.emulation:
        yield replace(plan, emulation={k: v for k, v in plan.emulation.items() if k != key})
