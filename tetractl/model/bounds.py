"""Lower bounds of the total error that hold for every sequence of common directions.

The bounds show, before any trial, that some targets cannot be reached. N robots move by the paper's
equations (1)-(3) for at most t seconds: theta_i' = a_i sin(u - theta_i), with one u for all. Let
g_i be the vector from a robot's start to its target, e_i its distance to the target at the end, and
w_i the integral of its unit heading vector, so that the robot moves by v_i w_i. Each function
derives its part:

    compute_min_distances   e_i >= |g_i| - v_i t              one robot drives straight
    compute_drift_bounds    |w_1 - w_2| <= G(t)               two robots turn by the same u
    _compute_pair_bounds    e_1 + e_2 >= min(v_1, v_2) (|g_1 / v_1 - g_2 / v_2| - G(t))
    _minimise_error_sum     the minimum of e_1 + ... + e_N under all these constraints

The bounds also hold for the Euler model (4)-(6) and held wheel speeds (24)-(25), see
`compute_drift_bounds`.
"""

import numpy as np
from numpy.typing import NDArray

from tetractl.core import elementwise
from tetractl.core.poses import Floats, wrap
from tetractl.core.setup import Setup

PAIRS_MAX = 1000
"""Maximum number of pairs of robots in the linear programme.

The programme uses the pairs that raise the bound most. The bound also holds without the other
pairs, which could only raise it.
"""


@np.errstate(over="ignore")  # a robot may be so fast that the distance overflows
def compute_min_distances(setup: Setup, seconds: float) -> Floats:
    """Compute how near to its target each robot can come in a time [length unit], shape (N,).

    The distance is 0 if the robot can arrive within `seconds`. Each robot is assumed to drive
    straight to its target. No other path brings a robot nearer, because |w_i| <= t.
    """
    gaps = setup.starts.distances(setup.targets)
    return np.maximum(gaps - setup.speed * seconds, 0.0)


# if both robots turn in the same way, divisions by 0; if almost, e^(k t) overflows before D is 2
@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def compute_drift_bounds(
    a_1: Floats, a_2: Floats, heading_difference: Floats, seconds: float
) -> Floats:
    """Compute an upper bound G of how far the common direction can part two robots [s].

    The bound is G >= |w_1 - w_2|, where w is the integral of a robot's unit heading vector over at
    most `seconds`.

    Let delta = theta_1 - theta_2, s = a_1 + a_2, d = |a_1 - a_2| and m be u minus the mean
    heading. Then delta' = a_1 sin(m - delta/2) - a_2 sin(m + delta/2) = (a_1 - a_2) sin m
    cos(delta/2) - s cos m sin(delta/2), and over all m

        |delta|' <= sqrt(d^2 cos^2(delta/2) + s^2 sin^2(delta/2)) <= sqrt(d^2 + (s delta/2)^2).

    So |delta| never exceeds the solution D of D' = sqrt(d^2 + (s D/2)^2) from D(0) = |delta(0)|:

        D(t) = D(0) cosh(k t) + B sinh(k t),   k = s/2,   B = sqrt((2d/s)^2 + D(0)^2).

    Unit vectors that differ in angle by delta have the distance 2 |sin(delta/2)| <= min(|delta|,
    2): G is the integral of min(D, 2). Robots with equal a and start heading have D = 0 and G = 0:
    their paths have the same shape.

    The bound also holds in the Euler model and with held wheel speeds. The right-hand side of D'
    grows with D, so a step along the tangent stays below D, and a left Riemann sum of a growing
    function stays below its integral.

    Args:
        a_1: Turning rate of the first robot of each pair [rad/s].
        a_2: Turning rate of the second robot [rad/s].
        heading_difference: Difference of the start headings of each pair [rad], at least 0.
        seconds: Duration [s]. All arguments broadcast.
    """
    rate = (a_1 + a_2) / 2  # k
    rate_contrast = np.abs(a_1 - a_2) / rate  # 2d/s
    slope = elementwise.hypot(rate_contrast, heading_difference)  # B
    # D = 2 is a quadratic equation in e^(k t), of which this is the solution
    growth = (2 + np.sqrt(4 + np.square(rate_contrast))) / (heading_difference + slope)
    until_s = np.clip(elementwise.log(growth) / rate, 0.0, seconds)
    # the integral of D up to that time; from then on min(D, 2) is 2
    growth_gain = elementwise.expm1(rate * until_s)
    growth_loss = growth_gain / (1 + growth_gain)
    # sinh(k t) is (growth_gain + growth_loss)/2; cosh(k t) - 1 is growth_gain growth_loss/2
    grown = heading_difference * (growth_gain + growth_loss) + slope * growth_gain * growth_loss
    integral = grown / (2 * rate)
    bound = np.minimum(integral, 2 * until_s) + 2 * (seconds - until_s)
    return np.where(heading_difference + slope > 0, bound, 0.0)


def compute_min_total_error(setup: Setup, seconds: float) -> float:
    """Compute a lower bound of the total error after `seconds` [length unit].

    No sequence of common directions leads to a smaller sum of the robots' distances from their
    targets. Obstacles are ignored.
    """
    single_errors = compute_min_distances(setup, seconds)
    pair_indices, pair_errors = _compute_pair_bounds(setup, seconds)
    gain = pair_errors - single_errors[pair_indices[:, 0]] - single_errors[pair_indices[:, 1]]
    raising_pairs = np.flatnonzero((gain > 0) & np.isfinite(gain))
    raising_pairs = raising_pairs[np.argsort(-gain[raising_pairs], kind="stable")[:PAIRS_MAX]]
    if not raising_pairs.size:
        return float(single_errors.sum())
    return _minimise_error_sum(
        single_errors, pair_indices[raising_pairs], pair_errors[raising_pairs]
    )


@np.errstate(over="ignore", invalid="ignore")  # of robots that hardly move, p overflows
def _compute_pair_bounds(setup: Setup, seconds: float) -> tuple[NDArray[np.int64], Floats]:
    """Compute a lower bound of e_1 + e_2 for each pair of moving robots.

    The result consists of the pairs (P, 2) and their bounds (P,). A bound is not finite if a
    number overflows. With p_i = g_i / v_i,

        e_1 + e_2 = v_1 |w_1 - p_1| + v_2 |w_2 - p_2| >= min(v_1, v_2) (|p_1 - p_2| - G(t)).

    If G = 0 and t is long enough, robots come as near as that.
    """
    i, j = np.triu_indices(len(setup.names), 1)
    both_move = (setup.speed[i] > 0) & (setup.speed[j] > 0)
    i = i[both_move]
    j = j[both_move]
    headings = setup.starts.heading
    heading_difference = np.abs(wrap(headings[i] - headings[j]))
    drift_s = compute_drift_bounds(setup.a[i], setup.a[j], heading_difference, seconds)
    speed = np.where(setup.speed > 0, setup.speed, 1)
    p = (setup.targets - setup.starts.xy) / speed[:, None]
    gaps = elementwise.hypot(*(p[i] - p[j]).T) - drift_s
    return np.column_stack([i, j]), np.minimum(setup.speed[i], setup.speed[j]) * gaps


def _minimise_error_sum(
    single_errors: Floats, pair_indices: NDArray[np.int64], pair_errors: Floats
) -> float:
    """Compute the minimum of the total error e_1 + ... + e_N by a linear programme.

    The constraints are that each e_i is at least the robot's bound in `single_errors`, and that the
    sum e_i + e_j of each pair (i, j) is at least the pair's bound in `pair_errors`. If the solver
    fails, the result is a weaker lower bound.
    """
    from scipy.optimize import linprog
    from scipy.sparse import coo_array

    rows = np.repeat(np.arange(len(pair_indices)), 2)
    shape = (len(pair_indices), len(single_errors))
    sums = coo_array((-np.ones(rows.size), (rows, pair_indices.ravel())), shape)
    scale = max(pair_errors.max(), 1.0)  # the solver's tolerances are absolute
    solution = linprog(
        np.ones(len(single_errors)),
        A_ub=sums.tocsr(),
        b_ub=-pair_errors / scale,
        bounds=np.column_stack([single_errors / scale, np.full(len(single_errors), np.inf)]),
    )
    # if the solver fails, each single pair still bounds the total
    fallback = single_errors.sum() + np.max(pair_errors - single_errors[pair_indices].sum(axis=1))
    return float(solution.fun * scale if solution.success else fallback)
