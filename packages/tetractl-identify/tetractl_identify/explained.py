"""How much of the motion of robots their commands explain: the one check of tables and logs.

Let m be what was measured in each step (a turn, or a distance, which is below 0 if it is driven
backwards), f what the fitted model makes of the commands, and N the sum of squares that the noise
of the poses alone would make. The commands explain the fraction

    1 - (sum (m - f)^2 - N) / (sum m^2 - N),

which is unknown if sum m^2 is not significantly above N. Noise hides slow motion in single steps,
and motion to and fro cancels over seconds, so the fraction is taken over steps and over seconds,
and the larger one counts.

A distance is the length of the way, ahead or aside: a car that slips in its turns drives as far as
it is asked to, but not along its heading. Whether headings point ahead is a value of its own.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.core.errors import UsageError, printable
from tetractl.core.poses import Floats, Integers
from tetractl_identify.pose_steps import Complex

HALF = 0.5
"""Fraction of the motion below which the commands and the poses do not belong together."""
SURE = 3.0
"""Standard deviations of the noise's sum of squares above which motion is significant."""
WINDOW_S = 1.0
"""Duration of the windows over which steps are added [s]."""
CHECKLIST = "go through the checklist in docs/how-to/identify.md"
"""A hint."""


@dataclass(frozen=True, slots=True)
class Explained:
    """How much of a robot's turning or of its distance travelled the commands explain.

    Attributes:
        fraction: The explained fraction, from 0 to 1. None if nothing is significantly there.
        rest: Sum of squares that neither the commands nor the noise of the poses explain.
        asked: Sum of squares that the commands ask for.
    """

    fraction: float | None
    rest: float
    asked: float

    def is_contradicted(self, may_follow: bool) -> bool:
        """Decide whether the motion contradicts the commands.

        A robot that is hardly asked to turn wanders more than it turns by its commands. This is no
        contradiction as long as it may follow them.

        Args:
            may_follow: Whether the interval of the fitted gain contains usual gains.
        """
        if self.fraction is None or self.fraction >= HALF:
            return False
        return self.asked >= self.rest or not may_follow

    def __str__(self) -> str:
        return "-" if self.fraction is None else f"{self.fraction:.0%}"


def explained(
    measured: Complex | Floats, fitted: Floats, asked: Floats, noise: float, windows: Integers
) -> Explained:
    """Compare measured steps with those that the commands explain.

    Args:
        measured: Measured turns, shape (M,), or complex distances along and across the heading.
        fitted: Steps that the model makes of the commands, shape (M,).
        asked: Steps that the commands ask for, shape (M,).
        noise: Standard deviation of each component of a pose.
        windows: Number of the window in which each step is, shape (M,). Steps of one window follow
            one another without a gap.
    """
    components = 2 if np.iscomplexobj(measured) else 1
    by_scale: list[Explained] = []
    for groups in (np.arange(len(fitted)), windows):
        _, group = np.unique(groups, return_inverse=True)
        moved = _sums(measured, group)
        total = float(np.square(moved).sum())
        count = components * (group.max(initial=-1) + 1)
        of_noise = 2 * noise**2 * count  # a step has the noise of two poses
        unexplained = np.square(moved - _sums(fitted, group)).sum()
        # a length has the noise of one component: the other one only turns it
        rest = max(float(unexplained) - of_noise / components, 0.0)
        is_significant = total > of_noise * (1 + SURE * math.sqrt(3 / max(count, 1)))
        fraction = max(0.0, 1 - rest / (total - of_noise)) if is_significant else None
        by_scale.append(Explained(fraction, rest, float(np.square(_sums(asked, group)).sum())))
    return max(by_scale, key=lambda scale: -1.0 if scale.fraction is None else scale.fraction)


def _sums(steps: Complex | Floats, group: Integers) -> Floats:
    """Add the steps (M,) of each group. Complex steps give lengths, below 0 if they lead back."""
    ahead = np.bincount(group, np.real(steps)).astype(np.float64)
    if not np.iscomplexobj(steps):
        return ahead
    across = np.bincount(group, np.imag(steps)).astype(np.float64)
    return np.copysign(np.hypot(ahead, across), ahead)


def windows_of(begin_s: Floats, end_s: Floats) -> Integers:
    """Number the windows of WINDOW_S of steps (M,) from `begin_s` to `end_s` [s].

    A gap between two steps begins a new window.
    """
    if not len(begin_s):
        return np.zeros(0, dtype=np.int64)
    is_new = np.append(True, np.abs(begin_s[1:] - end_s[:-1]) > 1e-6)
    run = np.cumsum(is_new) - 1
    since_s = begin_s - begin_s[is_new][run]
    window = (since_s / WINDOW_S + 1e-9).astype(np.int64)
    changes = np.append(True, (np.diff(run) != 0) | (np.diff(window) != 0))
    return np.cumsum(changes)


def refuse_contradicted(sources: Sequence[str], problems: Sequence[tuple[str, str]]) -> None:
    """Raise UsageError if the commands and poses of some robots do not belong together.

    Args:
        sources: The files, as messages name them.
        problems: The robots with what the commands explain of them.
    """
    if not problems:
        return
    robots = ", ".join(printable(name) for name, _ in problems)
    details = "; ".join(f"{printable(name)}: {text}" for name, text in problems)
    raise UsageError(
        f"{' and '.join(sources)}: the commands and the poses of {robots} do not belong together: "
        f"the commands explain too little of what the robots did ({details})",
        CHECKLIST,
    )
