"""Which robot goes to which target, if any robot may go to any."""

import numpy as np

from tetractl.core.poses import Floats


def dealt(starts: Floats, targets: Floats) -> list[int]:
    """Return the index (N,) of the target that each start gets: starts (N, 2), targets (M, 2).

    M must be at least N. The sum of the squared distances from start to target is minimal, which
    minimises the motion that is not common to all robots.
    """
    from scipy.optimize import linear_sum_assignment  # slow to import, and seldom needed

    squares = np.square(starts[:, None] - targets).sum(axis=2)
    return linear_sum_assignment(squares)[1].tolist()
