"""The predicted path of one sequence: `tetractl.control.cost.predict`, compiled."""

import math

from tetractl.control.kernels.cache import compiled
from tetractl.control.kernels.motion import derivatives
from tetractl.control.kernels.options import ENTRY_FAST


@compiled(**ENTRY_FAST)
def predict(u, a, v, drift, first_period, period, motion, path):
    """Fill path (L + 1, N, 3), whose first row is the start, with the poses under u (L,).

    The class of `motion`, a motion's constants, defines how robots move.
    """
    for j in range(u.size):
        t, cu, su = first_period if j == 0 else period, math.cos(u[j]), math.sin(u[j])
        for i in range(a.size):
            x, y, heading = path[j, i, 0], path[j, i, 1], path[j, i, 2]
            c, s = math.cos(heading), math.sin(heading)
            own_cu, own_su = (
                cu * drift[0, i] - su * drift[1, i],
                su * drift[0, i] + cu * drift[1, i],
            )
            step = derivatives(motion, c, s, own_cu, own_su, a[i], v[i], t)
            path[j + 1, i, 0], path[j + 1, i, 1] = (
                x + step[0] + t * drift[2, i],
                y + step[1] + t * drift[3, i],
            )
            path[j + 1, i, 2] = heading + step[2]
