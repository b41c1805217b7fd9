"""Can these robots be steered together, and how well? Of one setup, along several good plans."""

from dataclasses import dataclass

import numpy as np

from tetractl.analysis.closed_loop import Noise, end_covariance, mean_errors
from tetractl.analysis.linear import linearise
from tetractl.analysis.plans import plans
from tetractl.control.mpc import MpcSection
from tetractl.core.poses import Floats
from tetractl.core.setup import Setup


@dataclass(frozen=True, slots=True)
class Steering:
    """What M plans of N robots allow; lengths in the spec's unit.

    `reaching` of the M plans end at the targets, the shortest of them after `shortest` signals,
    None for none. `errors` (M,) are the predicted mean total errors with feedback, and `open_loop`
    (M,) those without; `planned` (M,) are the total errors without any noise. Of the plan whose
    predicted error is the median one: `signals` is its length, `singular` (2N,) the singular values
    of the derivative of the ends by the signals [length unit/rad], descending, `weakest` (N,) each
    robot's share of the direction of the least, `robot_errors` (N,) the predicted mean errors and
    `covariance` (N, 2, 2) that of each end, and `free_covariance` the same without feedback.
    """

    reaching: int
    shortest: int | None
    signal_s: float
    errors: Floats
    open_loop: Floats
    planned: Floats
    signals: int
    singular: Floats
    weakest: Floats
    robot_errors: Floats
    covariance: Floats
    free_covariance: Floats

    @property
    def error(self) -> float:
        """The predicted mean total error with feedback, the median of the plans.

        A controller leaves a plan along which robots are hard to hold for a better one.
        """
        return float(np.median(self.errors))


def steering(section: MpcSection, setup: Setup, noise: Noise, seed: int, count: int) -> Steering:
    """Analyse the robots of a setup along the plans of so many trials."""
    found, linear = [], []
    for planned in plans(section, setup, seed, count):
        found.append(planned)
        linear.append(linearise(planned.problem, planned.plan.signals))
    closed = [end_covariance(one, noise, True, section.estimate) for one in linear]
    free = [end_covariance(one, noise, corrects=False) for one in linear]
    each = [mean_errors(p, one.miss) for p, one in zip(closed, linear, strict=True)]
    errors = np.array([one.sum() for one in each])
    middle = int(np.argsort(errors)[(len(errors) - 1) // 2])
    left, singular, _ = np.linalg.svd(linear[middle].by_signal, full_matrices=False)
    size = 2 * len(setup.names)
    values = np.zeros(size)  # fewer signals than coordinates leave some at 0
    values[: len(singular)] = singular
    shares = (left[:, -1] ** 2).reshape(-1, 2).sum(axis=1)
    return Steering(
        reaching=sum(one.reaches for one in found),
        shortest=min((one.shortest for one in found if one.shortest is not None), default=None),
        signal_s=section.hold * section.period,
        errors=errors,
        open_loop=np.array(
            [mean_errors(p, one.miss).sum() for p, one in zip(free, linear, strict=True)]
        ),
        planned=np.array([one.miss.sum() for one in linear]),
        signals=len(found[middle].plan.signals),
        singular=values,
        weakest=shares,
        robot_errors=each[middle],
        covariance=_each(closed[middle]),
        free_covariance=_each(free[middle]),
    )


def _each(covariance: Floats) -> Floats:
    """Return the covariance of each robot's end, (N, 2, 2), of that of all, (2N, 2N)."""
    count = len(covariance) // 2
    robots = np.arange(count)
    return covariance.reshape(count, 2, count, 2)[robots, :, robots, :]
