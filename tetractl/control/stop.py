"""When a search ends: the paper's criterion (20) and unit-free alternatives."""

import numpy as np

from tetractl.core.poses import Floats
from tetractl.experiment.controller import BudgetStop, PaperStop, RelativeStop, Stop, TargetStop


def stopped(history: Floats, stop: Stop) -> str | None:
    """Return why to stop after iteration z = len(history) - 1, or None to go on.

    history[m] is J(u_gb) after iteration m. Only a target may stop a search before z > 10.
    """
    match stop:
        case BudgetStop():
            return None
        case TargetStop(cost=cost):
            return "target" if history[-1] <= cost else None
        case RelativeStop(window=window, decrease=decrease):
            if len(history) <= max(window, 10) + 1:
                return None
            fallen = history[-1 - window] - history[-1]
            return "criterion" if fallen <= decrease * abs(history[-1 - window]) else None
        case PaperStop():
            return "criterion" if paper_criterion(history) else None


def paper_criterion(history: Floats) -> bool:
    """Evaluate (20) as printed, after iteration z = len(history) - 1.

    C = sum_{m=z-10}^{z} log J(m) / 2;  Delta = sum_{m=z-9}^{z} log(J(m-1) - J(m));
    stop if z > 10 and Delta < C. An iteration without improvement gives log 0 = -inf, hence a
    stop; J = 0 gives -inf on both sides and no stop. The logarithms make it depend on the unit of
    length.
    """
    z = len(history) - 1
    if z <= 10:
        return False
    last = history[z - 10 :]
    with np.errstate(divide="ignore"):
        c = np.log(last).sum() / 2
        delta = np.log(last[:-1] - last[1:]).sum()
    return bool(delta < c)
