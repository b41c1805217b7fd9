"""Criteria that end an optimiser's search: the paper's equation (20), and simpler ones."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from tetractl.core import elementwise
from tetractl.core.plan import StopReason
from tetractl.core.poses import Floats
from tetractl.spec.base import Model, Positive

WINDOW_ITERATIONS = 10
"""Number of iterations over which the cost must fall for a search to continue.

During the first iterations, up to this number, only the criterion `target` can stop a search.
"""


class PaperStop(Model):
    """The stop criterion of a search by the paper's equation (20), as printed.

    The criterion compares logarithms of lengths, so it depends on the length unit.
    """

    type: Literal["paper"]


class RelativeStop(Model):
    """A criterion that stops a search if the best cost fell by at most 1 % over ten iterations."""

    type: Literal["relative"]


class TargetStop(Model):
    """A criterion that stops a search as soon as the best cost J is at most `cost`.

    `cost` is in the spec's length unit.
    """

    type: Literal["target"]
    cost: Positive
    """The cost J that is good enough [length unit]."""


class BudgetStop(Model):
    """The criterion that never stops a search early, so that it does all its iterations."""

    type: Literal["budget"]


StopCriterion = Annotated[
    PaperStop | RelativeStop | TargetStop | BudgetStop, Field(discriminator="type")
]


def reason_to_stop(history: Floats, criterion: StopCriterion) -> StopReason | None:
    """Check whether a stop criterion ends a search after iteration z = len(history) - 1.

    Up to z = 10, only the criterion `target` can stop a search.

    Args:
        history: J(u_gb) after each iteration, shape (z + 1,).
        criterion: The spec's stop criterion.

    Returns:
        The reason to stop. None to continue.
    """
    match criterion:
        case BudgetStop():
            return None
        case TargetStop(cost=cost):
            return StopReason.TARGET if history[-1] <= cost else None
        case RelativeStop():
            if len(history) <= WINDOW_ITERATIONS + 1:
                return None
            cost_before = history[-1 - WINDOW_ITERATIONS]
            has_stalled = cost_before - history[-1] <= 0.01 * abs(cost_before)
            return StopReason.CRITERION if has_stalled else None
        case PaperStop():
            return StopReason.CRITERION if meets_paper_criterion(history) else None


def meets_paper_criterion(history: Floats) -> bool:
    """Check whether the paper's equation (20) ends a search after iteration z = len(history) - 1.

        C     = sum_{m=z-10}^{z} log J(m) / 2
        Delta = sum_{m=z-9}^{z} log(J(m-1) - J(m))

    The search stops if z > 10 and Delta < C. An iteration without improvement gives log 0 = -inf,
    and therefore a stop. J = 0 gives -inf on both sides, and no stop. Because of the logarithms,
    the criterion depends on the unit of length.

    Args:
        history: J(u_gb) after each iteration, shape (z + 1,).
    """
    z = len(history) - 1
    if z <= WINDOW_ITERATIONS:
        return False
    window = history[z - WINDOW_ITERATIONS :]
    with np.errstate(divide="ignore"):
        c = elementwise.log(window).sum() / 2
        delta = elementwise.log(window[:-1] - window[1:]).sum()
    return bool(delta < c)
