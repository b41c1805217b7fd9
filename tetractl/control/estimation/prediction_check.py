"""Measure how far robots are from where the model predicted them, with the sign of the deviation.

The filters find out that a part of the motion does not fit the model, such as the heading of a
robot (`Estimate.misfit`). This module measures how large such a misfit is, and in which direction.
It predicts the robots AHEAD_S ahead from an earlier control step, with the directions that were
sent afterwards, and compares the prediction with the newest camera frame. The deviations of a robot
along its predicted heading, across it, and of the heading itself are averaged over time.

The deviation e of a heading is explained in one of two ways, if one of them explains a significant
part of it. Either the robot turns by a fraction f more than predicted, or it turns later by tau:

    e = f turned                        turned: predicted turn [rad]
    e = tau (rate_start - rate_end)     rates: predicted turning rates at both ends [rad/s]

f and tau follow from least squares.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tetractl.core import elementwise
from tetractl.core.clock import SECOND
from tetractl.core.elementary import exp
from tetractl.core.motion_estimate import PredictionErrors
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats, Observation, wrap

AHEAD_S = 0.4
"""Time over which robots are predicted [s]: two signals of a plan; chosen."""
MEMORY_S = 5.0
"""Time after which a comparison has lost most of its weight [s]; chosen."""
COUNT_MIN = 8
"""Minimum number of comparisons from which anything is concluded; chosen."""
EXPLAINED_MIN = 0.4
"""Minimum fraction of a heading's squared deviations that a cause must explain; chosen."""
TINY = 1e-30
"""Minimum of a denominator, so that nothing is divided by 0."""


class SentStep(NamedTuple):
    """A control step that sent a direction.

    Attributes:
        problem: The problem of the step, with the poses from which robots follow the direction.
        direction: The direction [rad].
        acts_ns: When the direction took effect, by the estimate of that time [ns].
    """

    problem: Problem
    direction: float
    acts_ns: int


class Comparison(NamedTuple):
    """A prediction of N robots, and a camera frame to compare it with.

    Attributes:
        steps: The control steps whose directions were followed, one control period each.
        frame: The frame.
    """

    steps: Sequence[SentStep]
    frame: Observation


class PredictionCheck:
    """Compares predicted with measured poses of N robots in one trial.

    Predictions are computed only when `errors` is called, because most trials never need them.

    Args:
        period_s: The control period [s].
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        steps_max = round(AHEAD_S / period_s) + 2
        self._steps: deque[SentStep] = deque(maxlen=steps_max)
        self._pending: deque[Comparison] = deque(maxlen=round(MEMORY_S / period_s))
        self._sums: DeviationSums | None = None

    def clear(self) -> None:
        """Forget the last control steps, because robots have stood still or were replaced."""
        self._steps.clear()

    def add_step(self, step: SentStep, frame: Observation) -> None:
        """Add a control step and the camera frame that was taken after it."""
        self._steps.append(step)
        recent = [s for s in self._steps if s.acts_ns >= frame.sampled_ns - AHEAD_S * SECOND]
        followed = [s for s in recent if s.acts_ns < frame.sampled_ns]
        if not followed or not frame.valid.all():
            return
        if frame.sampled_ns - followed[0].acts_ns > AHEAD_S / 2 * SECOND:
            self._pending.append(Comparison(followed, frame))

    def errors(self) -> PredictionErrors | None:
        """Compute the recent prediction errors. None if there are too few comparisons."""
        while self._pending:
            comparison = self._pending.popleft()
            robots = len(comparison.frame.valid)
            if self._sums is None:
                self._sums = DeviationSums(robots)
            self._sums.add(comparison, self._period_s)
        return None if self._sums is None else self._sums.errors()


class DeviationSums:
    """Weighted sums of N robots' deviations, and of the causes that may explain their headings."""

    def __init__(self, robots: int) -> None:
        self._count = 0
        self._weight = 0.0
        self._deviations = np.zeros((robots, 3))
        self._squares = np.zeros((robots, 3))
        self._effects = np.zeros((robots, 2))
        self._cause_squares = np.zeros((robots, 2))

    def add(self, comparison: Comparison, period_s: float) -> None:
        """Add one comparison, and let all earlier ones lose weight."""
        deviations, causes = deviations_and_causes(comparison, period_s)
        decay = exp(-period_s / MEMORY_S)
        self._count += 1
        self._weight = decay * self._weight + 1
        self._deviations = decay * self._deviations + deviations
        self._squares = decay * self._squares + np.square(deviations)
        self._effects = decay * self._effects + causes * deviations[:, 2:]
        self._cause_squares = decay * self._cause_squares + np.square(causes)

    def errors(self) -> PredictionErrors | None:
        """Compute the prediction errors. None after fewer than COUNT_MIN comparisons."""
        if self._count < COUNT_MIN:
            return None
        explainable = np.maximum(self._cause_squares * self._squares[:, 2:], TINY)
        explained = np.square(self._effects) / explainable
        slopes = self._effects / np.maximum(self._cause_squares, TINY)
        is_best = explained == explained.max(axis=1, keepdims=True)
        extra_turn, late_s = np.where(is_best & (explained > EXPLAINED_MIN), slopes, np.nan).T
        rms = np.sqrt(self._squares / self._weight)
        return PredictionErrors(AHEAD_S, self._deviations / self._weight, rms, late_s, extra_turn)


def deviations_and_causes(comparison: Comparison, period_s: float) -> tuple[Floats, Floats]:
    """Compute the deviations of a frame from its prediction, and their possible causes.

    Returns:
        The deviations of the frame from the prediction along the predicted heading, across it
        [length unit] and of the heading [rad], shape (N, 3); and what the deviation of the heading
        is proportional to, if a robot turns more or later than predicted: the predicted turn [rad],
        and the fall of the predicted rate [rad/s], shape (N, 2).
    """
    from tetractl.control.search.evaluate import compiled_prediction

    steps, frame = comparison
    first_step = steps[0]
    problem = replace(first_step.problem, period=period_s, first_period=period_s)
    path = compiled_prediction(problem, np.array([step.direction for step in steps])).path
    periods = (frame.sampled_ns - first_step.acts_ns) / SECOND / period_s
    whole_periods = min(int(periods), len(steps) - 1)
    before = path[whole_periods]
    at_frame = before + (periods - whole_periods) * (path[whole_periods + 1] - before)  # (N, 3)
    heading = at_frame[:, 2]
    x, y = (frame.poses.xy - at_frame[:, :2]).T
    cos, sin = elementwise.cos(heading), elementwise.sin(heading)
    heading_error = wrap(frame.poses.heading - heading)
    rates = (path[[1, whole_periods + 1], :, 2] - path[[0, whole_periods], :, 2]) / period_s
    deviations = np.array([cos * x + sin * y, cos * y - sin * x, heading_error]).T
    return deviations, np.array([heading - path[0, :, 2], rates[0] - rates[1]]).T
