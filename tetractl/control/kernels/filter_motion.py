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
    SINE,
    SIZE,
    SWING,
    X,
    Y,
)
from tetractl.core.kernels.kernel_cache import compiled
from tetractl.core.kernels.kernel_options import INLINE_FAST


@compiled(**INLINE_FAST)
def advance(model, i, z, cov, u, scale, seconds, more):
    """Predict state and covariance of one hypothesis of robot i by (1)-(3), by the midpoint rule;
    without a covariance, None, the compiler leaves out what it needs. `more` (MOVED, SIZE) is room
    for products.

    Lagging wheels follow the turning rate that the host sends, computed for the heading in which
    the robot would come to rest (`tetractl.model.motion.rolling.wish`).
    """
    left, lag, drives = seconds, model.lag, not math.isnan(u)
    goal = 1.0 if drives else 0.0
    if not drives and (lag == 0 or z[PACE] < ASSUMED.still):
        z[SWING] = z[PACE] = 0.0
    a, v = model.a[i] * math.exp(z[LN_A]), model.speed[i] * math.exp(z[LN_V])
    helix = model.helix * math.exp(z[LN_W]) if model.helix > 0 else 0.0
    while left > 0 and (drives or z[PACE] > 0):
        t = min(left, ASSUMED.substep_s)
        left -= ASSUMED.substep_s
        early = math.exp(-0.5 * t / lag) if lag > 0 else 0.0
        late = early * early
        off = u + z[BIAS] - z[HEADING] - lag * a * z[SWING]
        wish = math.sin(off) if drives else 0.0
        half = a * (0.5 * t * wish + lag * (1 - early) * (z[SWING] - wish))
        middle, off = z[HEADING] + half, off - 0.5 * t * a * wish
        wish, pull = (math.sin(off), math.cos(off)) if drives else (0.0, 0.0)
        turn = a * (t * wish + lag * (1 - late) * (z[SWING] - wish))
        chord = 1 - turn * turn / 24
        way = v * (t * goal + lag * (1 - late) * (z[PACE] - goal)) * chord
        z[SWING] = wish + late * (z[SWING] - wish)
        z[PACE] = goal + late * (z[PACE] - goal)
        keep = math.exp(-t * a * pull)
        dx, dy = way * math.cos(middle), way * math.sin(middle)
        z[X] += dx + t * z[FLOW_X]
        z[Y] += dy + t * z[FLOW_Y]
        z[HEADING] += turn
        if cov is not None:
            _spread(cov, more, t, dx, dy, half, turn, keep)
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


@compiled(**INLINE_FAST)
def _spread(cov, more, t, dx, dy, half, turn, keep):
    """Replace P by (1 + S) P (1 + S)' for the slopes S of the changes of x, y and heading.

    With M = S P this is P + M + M' + M S'. Heading, ln a and turn bias alone change the heading,
    and the headings in the middle, by which the way (dx, dy) turns.
    """
    stays, goes = 0.5 * (1 + keep), 0.5 * (1 - keep)
    for k in range(SIZE):
        middle = stays * cov[HEADING, k] + goes * cov[BIAS, k] + half * cov[LN_A, k]
        x = dx * cov[LN_V, k] + t * cov[FLOW_X, k] - dy * middle
        y = dy * cov[LN_V, k] + t * cov[FLOW_Y, k] + dx * middle
        heading = (1 - keep) * (cov[BIAS, k] - cov[HEADING, k]) + turn * cov[LN_A, k]
        more[X, k], more[Y, k], more[HEADING, k] = x, y, heading
    for j in range(HEADING + 1):
        middle = stays * more[j, HEADING] + goes * more[j, BIAS] + half * more[j, LN_A]
        x = dx * more[j, LN_V] + t * more[j, FLOW_X] - dy * middle
        y = dy * more[j, LN_V] + t * more[j, FLOW_Y] + dx * middle
        heading = (1 - keep) * (more[j, BIAS] - more[j, HEADING]) + turn * more[j, LN_A]
        cov[X, j] += x
        cov[Y, j] += y
        cov[HEADING, j] += heading
    _add(cov, more, X, HEADING + 1)


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
