"""Checks of the robots: what their targets ask of them, and how they differ."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from tetractl.core.poses import wrap
from tetractl.core.setup import Setup
from tetractl.model import bounds
from tetractl.model.bounds import reach
from tetractl.run.plausibility.case import Case, Doubt

ALIKE = 0.05
"""Relative difference of a, and difference of start headings [rad], up to which robots count as
alike."""


def out_of_reach(case: Case) -> Iterator[Doubt]:
    """Targets that a robot cannot come to in a trial, at full speed along a straight line."""
    for i, left in enumerate(reach(case.setup, case.longest_s)):
        if left > case.tolerance:
            yield Doubt(
                ("robots", i, "target"),
                f"is {_way(case, i)} away; in the {case.longest_s:.4g} s of a trial the robot "
                f"drives {case.setup.speed[i] * case.longest_s:.4g} {case.unit}, "
                f"{left:.4g} too few",
                "raise controller.steps_max, or bring the target nearer",
            )


def beyond_the_plan(case: Case) -> Iterator[Doubt]:
    """Targets that no plan of the first step can end at, though a trial lasts long enough."""
    if case.signals_max is None:
        return
    seconds = case.signals_max * case.signal_s
    left = reach(case.setup, seconds)
    far = (left > case.tolerance) & (reach(case.setup, case.longest_s) <= case.tolerance)
    if not far.any():
        return
    speed = np.where(far, case.setup.speed, 1.0)
    needed = np.where(far, left / speed + seconds, 0.0)
    i = int(needed.argmax())
    yield Doubt(
        ("controller", "horizon_max"),
        f"{case.setup.names[i]} is {_way(case, i)} from its target; in {case.signals_max} signals, "
        f"{seconds:.4g} s, it drives {speed[i] * seconds:.4g} {case.unit}, {left[i]:.4g} too few",
        f"set it to more than {math.ceil(needed[i] / case.signal_s)}",
    )


def _way(case: Case, i: int) -> str:
    gap = float(np.linalg.norm(case.setup.targets[i] - case.setup.starts.xy[i]))
    return f"{gap:.4g} {case.unit}"


def robots_alike(case: Case) -> Iterator[Doubt]:
    """Robots that one signal cannot tell apart, with targets that ask for it."""
    for group in _alike(case.setup):
        some = case.setup.only(group)
        least = bounds.least_total_error(some, case.longest_s, alike=True)
        if least <= max(len(group) * case.tolerance, 1e-6 * _size(case.setup)):
            continue
        first, *others = (case.setup.names[i] for i in group)
        spread = float(np.ptp(some.a) / some.a.mean())
        turned = float(np.abs(wrap(some.starts.heading - some.starts.heading[0])).max())
        if spread == 0 and turned < 1e-9:
            message = (
                f"is that of {first}, and so is the start heading: {_and(others)} can only follow "
                f"in parallel, and the least total error of the {len(group)} is"
            )
        else:
            message = (
                f"{_and(others)} and {first} differ by {100 * spread:.2g} % in a and "
                f"{turned:.2g} rad in start heading, too little to be told apart for certain: if "
                f"they did not differ, the least total error of the {len(group)} would be"
            )
        yield Doubt(
            ("robots", group[1], "a"),
            f"{message} {least:.4g} {case.unit}",
            "give them different a, or targets that lie to each other as the starts do",
        )


def _and(names: Sequence[str]) -> str:
    """Return names as in a sentence, very many cut short."""
    shown = list(names) if len(names) < 4 else [*names[:2], f"{len(names) - 2} more"]
    return " and ".join(filter(None, [", ".join(shown[:-1]), shown[-1]]))


def _alike(setup: Setup) -> Iterator[list[int]]:
    """Yield groups of robots that hardly differ in a and start heading from the first of them."""
    left = np.ones(len(setup.a), dtype=np.bool_)
    for i in range(len(setup.a)):
        if not left[i]:
            continue
        near = np.abs(setup.a - setup.a[i]) <= ALIKE * np.maximum(setup.a, setup.a[i])
        near &= np.abs(wrap(setup.starts.heading - setup.starts.heading[i])) <= ALIKE
        group = np.flatnonzero(near & left)
        left[group] = False
        if len(group) > 1:
            yield group.tolist()


def error_left(case: Case) -> Iterator[Doubt]:
    """A total error that no plan can undercut, from all robots together."""
    least = case.least_total_error
    count = len(case.setup.a)
    if least > max(count * case.tolerance, 1e-6 * _size(case.setup)):
        yield Doubt(
            ("robots",),
            f"least total error of any plan: {least:.4g} {case.unit}",
            "no controller can do better with these a, speeds, starts and targets",
        )


def _size(setup: Setup) -> float:
    return max(setup.arena.width, setup.arena.height)
