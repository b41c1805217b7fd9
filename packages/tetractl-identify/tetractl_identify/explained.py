"""Computes how much of the robots' motion their commands explain, for tables and for logs.

Each step of a robot has a measured value m: a turn, or a distance, which is negative if the robot
drives backwards. Let f be the value that the fitted model predicts from the commands, and N the sum
of squares that the noise of the poses alone would cause. The commands explain the fraction

    1 - (sum (m - f)^2 - N) / (sum m^2 - N).

The fraction is unknown if sum m^2 is not significantly above N. It is computed twice, over single
steps and over seconds, and the larger value counts. In single steps, noise hides slow motion. Over
seconds, motion back and forth cancels.

A distance is the length of the displacement, in whatever direction it points. A car that slips in
its turns drives as far as commanded, but not along its heading. Whether the heading points ahead is
identified as a separate value.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.core.errors import UsageError, printable
from tetractl.core.poses import Floats, Integers
from tetractl_identify.pose_steps import Complex

EXPLAINED_MIN = 0.5
"""Fraction of the motion below which the commands and the poses do not belong together."""
NOISE_STDS = 3.0
"""Excess of a motion over the noise above which it is significant.

It is the number of standard deviations of the noise's sum of squares.
"""
WINDOW_S = 1.0
"""Duration of the windows over which steps are added [s]."""
CHECKLIST = "work through the checklist in docs/how-to/identify.md"
"""Hint that names the checklist."""


@dataclass(frozen=True, slots=True)
class Explained:
    """How much of a robot's turning, or of its distance travelled, the commands explain.

    Attributes:
        fraction: The explained fraction, from 0 to 1. None if there is no significant motion.
        unexplained_sum: Sum of squares that neither the commands nor the noise of the poses
            explain.
        asked_sum: Sum of squares that the commands ask for.
    """

    fraction: float | None
    unexplained_sum: float
    asked_sum: float

    def is_contradicted(self, may_follow: bool) -> bool:
        """Check whether the motion contradicts the commands.

        A robot that is hardly asked to turn may wander more than it turns by its commands. This is
        no contradiction as long as the robot may follow them.

        Args:
            may_follow: Whether the interval of the fitted gain contains usual gains.
        """
        if self.fraction is None or self.fraction >= EXPLAINED_MIN:
            return False
        return self.asked_sum >= self.unexplained_sum or not may_follow

    def __str__(self) -> str:
        return "-" if self.fraction is None else f"{self.fraction:.0%}"


def explain_steps(
    measured_steps: Complex | Floats,
    fitted_steps: Floats,
    asked_steps: Floats,
    noise: float,
    windows: Integers,
) -> Explained:
    """Compute how much of the measured steps the commands explain.

    Args:
        measured_steps: Measured turns, shape (M,), or complex distances along and across the
            heading.
        fitted_steps: Steps that the model predicts from the commands, shape (M,).
        asked_steps: Steps that the commands ask for, shape (M,).
        noise: Standard deviation of each component of a pose.
        windows: Index of the window that contains each step, shape (M,). The steps of a window
            follow one another without a gap.
    """
    components_per_step = 2 if np.iscomplexobj(measured_steps) else 1
    by_scale: list[Explained] = []
    for group_labels in (np.arange(len(fitted_steps)), windows):
        _, group_index = np.unique(group_labels, return_inverse=True)
        measured_sums = _sum_by_group(measured_steps, group_index)
        motion_sum = float(np.square(measured_sums).sum())
        component_count = components_per_step * (group_index.max(initial=-1) + 1)
        noise_sum = 2 * noise**2 * component_count  # a step has the noise of two poses
        residual_sum = np.square(measured_sums - _sum_by_group(fitted_steps, group_index)).sum()
        # a length has the noise of one component: the other one only turns it
        unexplained_sum = max(float(residual_sum) - noise_sum / components_per_step, 0.0)
        is_significant = motion_sum > noise_sum * (
            1 + NOISE_STDS * math.sqrt(3 / max(component_count, 1))
        )
        fraction = (
            max(0.0, 1 - unexplained_sum / (motion_sum - noise_sum)) if is_significant else None
        )
        by_scale.append(
            Explained(
                fraction,
                unexplained_sum,
                float(np.square(_sum_by_group(asked_steps, group_index)).sum()),
            )
        )
    return max(by_scale, key=lambda scale: -1.0 if scale.fraction is None else scale.fraction)


def _sum_by_group(steps: Complex | Floats, group_index: Integers) -> Floats:
    """Add the steps (M,) of each group.

    Complex steps give lengths, which are negative if they lead backwards.
    """
    along = np.bincount(group_index, np.real(steps)).astype(np.float64)
    if not np.iscomplexobj(steps):
        return along
    across = np.bincount(group_index, np.imag(steps)).astype(np.float64)
    return np.copysign(np.hypot(along, across), along)


def assign_windows(begin_s: Floats, end_s: Floats) -> Integers:
    """Assign steps (M,) from `begin_s` to `end_s` [s] to windows that last WINDOW_S.

    A gap between two steps starts a new window.
    """
    if not len(begin_s):
        return np.zeros(0, dtype=np.int64)
    starts_run = np.append(True, np.abs(begin_s[1:] - end_s[:-1]) > 1e-6)
    run_index = np.cumsum(starts_run) - 1
    run_time_s = begin_s - begin_s[starts_run][run_index]
    window_in_run = (run_time_s / WINDOW_S + 1e-9).astype(np.int64)
    starts_window = np.append(True, (np.diff(run_index) != 0) | (np.diff(window_in_run) != 0))
    return np.cumsum(starts_window)


def refuse_contradicted(sources: Sequence[str], problems: Sequence[tuple[str, str]]) -> None:
    """Raise an error if there are robots whose commands and poses do not belong together.

    Args:
        sources: Names of the files, for the message.
        problems: The name of each such robot, and how little of its motion the commands explain.

    Raises:
        UsageError: If `problems` is not empty.
    """
    if not problems:
        return
    robots = ", ".join(printable(name) for name, _ in problems)
    details = "; ".join(f"{printable(name)}: {description}" for name, description in problems)
    raise UsageError(
        f"{' and '.join(sources)}: the commands and the poses of {robots} do not belong "
        f"together, because the commands explain too little of the robots' motion ({details})",
        CHECKLIST,
    )
