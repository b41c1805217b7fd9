"""How a filter of `tetractl.control.filter` predicts the state of one hypothesis, and how sure it
is of it."""

import math

from tetractl.control.kernels.filter_state import (
    ASSUMED,
    BIAS,
    COSINE,
    FLOW_X,
    FLOW_Y,
    HEADING,
    LN_A,
    LN_V,
    LN_W,
    MOVED,
    PACE,
    SIDE,
    SINE,
    SIZE,
    SWING,
    X,
    Y,
)
from tetractl.core.kernels.kernel_cache import compiled
from tetractl.core.kernels.kernel_options import INLINE_FAST, inlined
from tetractl.model.motion import exact, rolling
from tetractl.model.motion.motion import PARAMETERS
from tetractl.model.motion.turn_rate import TURNING, by_turning, held, times, turning

differentiate, rolled = inlined(exact.differentiate), inlined(rolling.rolled)
rate, kept = inlined(turning), inlined(held)
complete, scaled = inlined(by_turning), inlined(times)

NONE = (0.0, 0.0, 0.0)
NOTHING = NONE, (0.0, 0.0, 1.0), NONE, (NONE,) * len(PARAMETERS + TURNING)
"""The step of a robot at rest."""
UNKNOWN_TURN = math.pi**2 / 3
"""Variance of a heading that may be any [rad2]. Linearised, that of a robot that drives against its
direction grows without bound, until rounding makes the covariance none."""


@compiled(**INLINE_FAST)
def parameters_of(model, i, z):
    """Return PARAMETERS and TURNING of robot i in a state."""
    known, saturation = model.parameters[i], 1.0 if model.helix > 0 else math.exp(min(z[LN_W], 0.0))
    return known[0] * math.exp(z[LN_A]), known[1] * math.exp(z[LN_V]), z[SIDE], saturation


@compiled(**INLINE_FAST)
def advance(model, i, z, cov, u, scale, seconds, more):
    """Predict state and covariance of one hypothesis of robot i; without a covariance, None, the
    compiler leaves out what it needs. `more` (MOVED, SIZE) is room for products.

    Lagging wheels follow the turning rate that the host sends, computed for the heading in which
    the robot would come to rest (`tetractl.model.motion.rolling.wish`): that heading follows (3),
    and the wheels its mean rate over a short step.
    """
    left, lag, drives = seconds, model.lag, not math.isnan(u)
    longest = max(ASSUMED.substep_s, seconds / ASSUMED.substeps)
    goal = 1.0 if drives else 0.0
    if not drives and (lag == 0 or z[PACE] < ASSUMED.still):
        z[SWING] = z[PACE] = 0.0
    own = parameters_of(model, i, z)
    helix = model.helix * math.exp(z[LN_W]) if model.helix > 0 else 0.0
    cu, su = (math.cos(u + z[BIAS]), math.sin(u + z[BIAS])) if drives else (1.0, 0.0)
    while left > 0 and (drives or z[PACE] > 0):
        t = min(left, longest)
        left -= t
        ends = z[HEADING] + lag * own[0] * z[SWING]
        c, s = math.cos(ends), math.sin(ends)
        a, slopes = rate(c, s, cu, su, own, t)
        if model.hold > 0:
            a, slopes = kept(a, slopes, cu * c + su * s, su * c - cu * s, model.hold)
        found = complete(differentiate(c, s, cu, su, (a, own[1]), t), slopes)
        if lag > 0:
            rest, slopes = (found, slopes) if drives else (NOTHING, NONE)
            found = _lagging(z, rest, goal, own, lag, t, slopes)
        dx, dy, turn = found[0]
        z[X] += dx + t * z[FLOW_X]
        z[Y] += dy + t * z[FLOW_Y]
        z[HEADING] += turn
        if cov is not None:
            _spread(cov, more, t, found)
        if helix > 0:
            angle = t * helix
            c, s = math.cos(angle), math.sin(angle)
            z[SINE], z[COSINE] = c * z[SINE] + s * z[COSINE], c * z[COSINE] - s * z[SINE]
            if cov is not None:
                _swing(cov, more, c - 1, s, angle * z[SINE], angle * z[COSINE])
        if cov is not None:
            for k in range(SIZE):
                factor = scale[0] if k <= Y else scale[1] if k == HEADING else 1.0
                cov[k, k] += factor * model.walk[k, i] * model.walk[k, i] * t
            if cov[HEADING, HEADING] > UNKNOWN_TURN:
                _bound(cov)


@compiled(**INLINE_FAST)
def _bound(cov):
    """Lower the variance of the heading to that of one of which nothing is known, and what depends
    on it with it."""
    share = math.sqrt(UNKNOWN_TURN / cov[HEADING, HEADING])
    for k in range(SIZE):
        cov[HEADING, k] *= share
        cov[k, HEADING] *= share


@compiled(**INLINE_FAST)
def _lagging(z, rest, goal, own, lag, t, slopes):
    """Return a short step of lagging wheels and its derivatives, given that of the heading in which
    they come to `rest`; swing and pace approach its mean turning rate over a, and the `goal`."""
    (a, v, _, _), (_, _, around), keep = own, rest[0], rest[1][2]
    wish, early = around / (a * t), math.exp(-0.5 * t / lag)
    late = early * early
    half = 0.5 * around + a * lag * (1 - early) * (z[SWING] - wish)
    turn = around + a * lag * (1 - late) * (z[SWING] - wish)
    way = v * (t * goal + lag * (1 - late) * (z[PACE] - goal))
    dx, dy = rolled(z[HEADING] + half - 0.5 * turn, turn, way)
    z[SWING] = wish + late * (z[SWING] - wish)
    z[PACE] = goal + late * (z[PACE] - goal)
    stays, goes = 0.5 * (1 + keep), 0.5 * (1 - keep)
    by_heading, by_u = (-dy * stays, dx * stays, keep), (-dy * goes, dx * goes, 1 - keep)
    by_a = -dy * half, dx * half, turn
    by_parameters = by_a, (dx, dy, 0.0), scaled(by_a, slopes[1]), scaled(by_a, slopes[2])
    return (dx, dy, turn), by_heading, by_u, by_parameters


@compiled(**INLINE_FAST)
def _spread(cov, more, t, found):
    """Replace P by (1 + S) P (1 + S)' for the slopes S of the changes of x, y and heading, those of
    the `Derivatives` found. With M = S P this is P + M + M' + M S'."""
    for k in range(SIZE):
        more[X, k], more[Y, k], more[HEADING, k] = _change(cov[:, k], t, found)
    for j in range(HEADING + 1):
        x, y, heading = _change(more[j], t, found)
        cov[X, j] += x
        cov[Y, j] += y
        cov[HEADING, j] += heading
    _add(cov, more, X, HEADING + 1)


@compiled(**INLINE_FAST)
def _change(by, t, found):
    """Return the changes of x, y and heading for small changes (SIZE,) of the state."""
    _, (x_h, y_h, _), (x_u, y_u, turn_u), by_parameters = found
    h, u = by[HEADING], by[BIAS]
    x, y, heading = x_h * h + x_u * u, y_h * h + y_u * u, turn_u * (u - h)
    for p in range(len(by_parameters)):
        x_p, y_p, turn_p = by_parameters[p]
        x += x_p * by[LN_A + p]
        y += y_p * by[LN_A + p]
        heading += turn_p * by[LN_A + p]
    return x + t * by[FLOW_X], y + t * by[FLOW_Y], heading


@compiled(**INLINE_FAST)
def _swing(cov, more, c, s, sine, cosine):
    """The same for the changes of the helix's sine and cosine."""
    for k in range(SIZE):
        p, q, w = cov[SINE, k], cov[COSINE, k], cov[LN_W, k]
        more[SINE, k], more[COSINE, k] = c * p + s * q + cosine * w, c * q - s * p - sine * w
    for j in range(SINE, MOVED):
        p, q, w = more[j, SINE], more[j, COSINE], more[j, LN_W]
        cov[SINE, j] += c * p + s * q + cosine * w
        cov[COSINE, j] += c * q - s * p - sine * w
    _add(cov, more, SINE, MOVED)


@compiled(**INLINE_FAST)
def _add(cov, more, first, end):
    """Add M + M' to P for the rows `first` to `end` of M (MOVED, SIZE), the others of which are 0;
    P stays symmetric."""
    for j in range(first, end):
        for k in range(SIZE):
            cov[j, k] += more[j, k]
        for k in range(first, end):
            cov[k, j] += more[j, k]
    for j in range(first, end):
        for k in range(SIZE):
            if k < first or k > j:
                cov[k, j] = cov[j, k]
