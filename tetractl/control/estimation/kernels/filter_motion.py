"""Predict one robot's state z and its covariance P over a short time, under one hypothesis.

This is the prediction step of a Kalman filter (`tetractl.control.estimation.filter`). A robot that
follows a direction u changes, in a short time t [s], by

    z <- f(z, u, t),    P <- F P F' + Q t,    F = df/dz.

The step f and its derivatives are the ones of the planner (`tetractl.model.motion.exact`), with the
turning rate of `tetractl.model.motion.turn_rate`.

Wheels that lag with a time constant T have two more states: a swing r, their turning rate divided
by a; and a pace g, their speed divided by v. The host assumes a lag T_h, and computes its own idea
of the swing, r_h. It sends the turning rate that equation (3) gives for the heading

    psi = theta + T_h a r_h,

at which the robot would come to a standstill if T_h were the true lag. So psi follows (3), except
for what the host does not know:

    dpsi/dt = a sin(u + beta - psi) + a (r - r_h).

If the host neglects the lag, T_h = 0, then r_h is sin(u + beta - psi) itself. In a short time, psi
turns by `rest_turn`; to compute this, psi starts half of the second term's integral further on. The
wheels follow the mean of the rate that is sent, w = rest_turn / (a t). With the time constant T, r
approaches w, and g approaches 1, or 0 for a robot that stops. With T_h, r_h approaches w:

    r' = w + (r - w) exp(-t/T),    turn = rest_turn + a T (r - w) (1 - exp(-t/T)),
    g' = 1 + (g - 1) exp(-t/T),    distance = v (t + T (g - 1) (1 - exp(-t/T))).

For a robot that stops, g' = g exp(-t/T) and distance = v T g (1 - exp(-t/T)). The path is an arc
with this turn and this distance. Its chord points to the heading in the middle of the arc.
"""

import math

from tetractl.control.estimation.kernels.filter_state import (
    FLOW_X,
    FLOW_Y,
    HEADING,
    HEADINGS,
    HELIX_COSINE,
    HELIX_SINE,
    HOST_SWING,
    LAG,
    LN_A,
    LN_FREQUENCY,
    LN_SATURATION,
    LN_SPEED,
    PACE,
    POSITIONS,
    SIDE,
    SWING,
    TURN_BIAS,
    X,
    Y,
)
from tetractl.control.search.kernels.elementary import cos, exp, sin
from tetractl.model.motion import exact, wheel_equations
from tetractl.model.motion.turn_rate import (
    RobotParameters,
    add_turning_derivatives,
    compute_held_turning_rate,
    compute_turning_rate,
    scale_derivatives,
)
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import INLINE_FAST, inlined

differentiate = inlined(exact.differentiate)
arc_displacement = inlined(wheel_equations.arc_displacement)
turn_rate = inlined(compute_turning_rate)
held_turn_rate = inlined(compute_held_turning_rate)
with_turning = inlined(add_turning_derivatives)
scaled = inlined(scale_derivatives)

STILL_PACE = 1e-3
"""Speed, as a fraction of v, below which a robot that was stopped counts as standing still."""
LEAST_LAG_S = 1e-3
"""Minimum lag used for wheels without a lag whose host assumes one [s]."""
SUBSTEP_S = 0.025
"""Maximum duration of a step of the prediction, after which random walks are added [s]."""
SUBSTEPS_MAX = 4000
"""Maximum number of steps of a prediction. Beyond 100 s, the steps become longer instead."""
NO_CHANGE = (0.0, 0.0, 0.0)
"""A change of x, y and the heading by 0."""
AT_REST = NO_CHANGE, (0.0, 0.0, 1.0), NO_CHANGE, (NO_CHANGE,) * len(RobotParameters._fields)
"""`Derivatives` of a robot that stands still: it does not move, and keeps its heading."""
UNKNOWN_HEADING = math.pi * math.pi / 3
"""Maximum variance of a heading: the variance of a uniformly distributed angle [rad2].

Without this limit, the linearised variance of a robot that drives against its direction grows
without bound, until the covariance is invalid because of rounding.
"""


@compiled(**INLINE_FAST)
def stands(u):
    """Check whether a direction is NaN, which means that the robot stands still."""
    return math.isnan(u)


@compiled(**INLINE_FAST)
def parameters_of(model, i, z):
    """Return turning rate a [rad/s], speed v [length unit/s], side and saturation of robot i.

    Args:
        model: The assumptions about the robots. The state holds a and v relative to these.
        i: The index of the robot.
        z: The state (STATES,).
    """
    a = model.parameters[i, 0] * exp(z[LN_A])
    speed = model.parameters[i, 1] * exp(z[LN_SPEED])
    return a, speed, z[SIDE], exp(min(z[LN_SATURATION], 0.0))


@compiled(**INLINE_FAST)
def advance(model, i, z, cov, u, noise_scale, seconds, scratch):
    """Predict the state z and the covariance P of robot i that follows the direction u.

    Args:
        model: The assumptions about the robots, a `FilterModel`.
        i: Index of the robot.
        z: Its state (STATES,), which changes.
        cov: P (n, n), which changes. With None, only the state is predicted.
        u: The direction [rad]; NaN if the robot is to stand still.
        noise_scale: Ratios (2,) of the bank; None if `cov` is None.
        seconds: How long the robot moves [s].
        scratch: A `FilterScratch` whose `jacobian` began as the unit matrix; None if `cov` is None.
    """
    drives = not stands(u)
    if not drives and (z[LAG] == 0 or z[PACE] < STILL_PACE):
        z[SWING] = 0.0
        z[PACE] = 0.0
        z[HOST_SWING] = 0.0
    parameters = parameters_of(model, i, z)
    helix_rad_s = 0.0
    if model.helix_rad_s > 0:
        helix_rad_s = model.helix_rad_s * exp(z[LN_FREQUENCY])
    cos_u = 1.0
    sin_u = 0.0
    if drives:
        cos_u = cos(u + z[TURN_BIAS])
        sin_u = sin(u + z[TURN_BIAS])
    longest = max(SUBSTEP_S, seconds / SUBSTEPS_MAX)
    remaining = seconds
    while remaining > 0 and (drives or z[PACE] > 0):
        t = min(remaining, longest)
        remaining -= t
        derivatives = _step(model, z, drives, cos_u, sin_u, parameters, t)
        _move(z, derivatives, t)
        angle = t * helix_rad_s
        if helix_rad_s > 0:
            _turn_helix(z, angle)
        if cov is not None:
            _fill_jacobian(scratch.jacobian, derivatives, z, angle, t)
            _propagate(cov, scratch.jacobian, scratch.product)
            _add_walk(model, i, cov, noise_scale, t)
            if cov[HEADING, HEADING] > UNKNOWN_HEADING:
                _bound_heading(cov)


@compiled(**INLINE_FAST)
def _step(model, z, drives, cos_u, sin_u, parameters, t):
    """Compute the `Derivatives` of a short step.

    The swings and the pace of lagging wheels, which are part of the state, are updated.
    """
    host_lag = model.host_lag_s
    lags = z[LAG] > 0 or host_lag > 0
    rest_heading = z[HEADING]
    if lags:
        rest_heading += host_lag * parameters[0] * z[HOST_SWING]
        rest_heading += 0.5 * _unknown_turn(
            z, rest_heading, cos_u, sin_u, parameters[0], host_lag, t
        )
    c = cos(rest_heading)
    s = sin(rest_heading)
    a, slopes = turn_rate(c, s, cos_u, sin_u, parameters, t)
    if model.hold[0] > 0:
        cos_phi = cos_u * c + sin_u * s
        sin_phi = sin_u * c - cos_u * s
        a, slopes = held_turn_rate(a, slopes, cos_phi, sin_phi, model.hold)
    rate = a * (sin_u * c - cos_u * s)
    own_step = differentiate(c, s, cos_u, sin_u, (a, parameters[1]), t)
    derivatives = with_turning(own_step, slopes)
    if lags:
        goal = 1.0 if drives else 0.0
        rest = derivatives if drives else AT_REST
        rest_slopes = slopes if drives else NO_CHANGE
        derivatives = _lagging(z, rest, rest_slopes, goal, parameters, host_lag, t)
    if drives and z[LAG] == 0:
        z[SWING] = rate / parameters[0]
        z[PACE] = 1.0
    if drives and host_lag == 0:
        z[HOST_SWING] = rate / parameters[0]
    return derivatives


@compiled(**INLINE_FAST)
def _unknown_turn(z, rest_heading, cos_u, sin_u, a, host_lag, t):
    """Compute the turn of the heading psi in a step of t [s] that the host does not know [rad].

    It is a times the integral of r - r_h, for the rate that is sent at the beginning of the step.
    It is exactly 0 if the host assumes the true lag.
    """
    sent = sin_u * cos(rest_heading) - cos_u * sin(rest_heading)
    true_distance = _remaining_distance(z[SWING] - sent, z[LAG], t)
    host_distance = _remaining_distance(z[HOST_SWING] - sent, host_lag, t)
    return a * (true_distance - host_distance)


@compiled(**INLINE_FAST)
def _remaining_distance(missing, lag, t):
    """Integrate over t [s] a difference that is `missing` at first and decays exponentially.

    Its time constant is `lag` [s]. Without a lag, the result is 0.
    """
    if lag == 0:
        return 0.0
    return missing * lag * (1 - exp(-t / lag))


@compiled(**INLINE_FAST)
def _lagging(z, rest, rest_slopes, goal, parameters, host_lag, t):
    """Compute the `Derivatives` of a short step of lagging wheels, and update their swing and pace.

    The derivatives follow from those of the heading at which the wheels will come to a standstill.
    If that heading changes, and a fraction `keep` of the change remains after the step, the chord
    of the step turns by the mean of both.
    """
    lag = max(z[LAG], LEAST_LAG_S)
    a = parameters[0]
    speed = parameters[1]
    rest_turn = rest[0][2]
    keep = rest[1][2]
    wish = rest_turn / (a * t)
    decay_half = exp(-0.5 * t / lag)
    decay = decay_half * decay_half
    turn_half = 0.5 * rest_turn + a * lag * (1 - decay_half) * (z[SWING] - wish)
    turn = rest_turn + a * lag * (1 - decay) * (z[SWING] - wish)
    distance = speed * (t * goal + lag * (1 - decay) * (z[PACE] - goal))
    dx, dy = arc_displacement(z[HEADING] + turn_half - 0.5 * turn, turn, distance)
    host_swing = z[HOST_SWING]
    z[SWING] = wish + decay * (z[SWING] - wish)
    z[PACE] = goal + decay * (z[PACE] - goal)
    z[HOST_SWING] = wish
    if host_lag > 0:
        host_decay_half = exp(-0.5 * t / host_lag)
        z[HOST_SWING] += host_decay_half * host_decay_half * (host_swing - wish)
    by_chord_x = -dy  # the displacement turned by a quarter
    by_chord_y = dx
    stays = 0.5 * (1 + keep)
    half_lost = 0.5 * (1 - keep)
    by_heading = (by_chord_x * stays, by_chord_y * stays, keep)
    by_u = (by_chord_x * half_lost, by_chord_y * half_lost, 1 - keep)
    by_a = (by_chord_x * turn_half, by_chord_y * turn_half, turn)
    by_speed = (dx, dy, 0.0)
    by_side = scaled(by_a, rest_slopes[1])
    by_saturation = scaled(by_a, rest_slopes[2])
    return (dx, dy, turn), by_heading, by_u, (by_a, by_speed, by_side, by_saturation)


@compiled(**INLINE_FAST)
def _move(z, derivatives, t):
    """Move x, y and the heading of the state z by one step of t [s], including the flow."""
    dx, dy, turn = derivatives[0]
    z[X] += dx + t * z[FLOW_X]
    z[Y] += dy + t * z[FLOW_Y]
    z[HEADING] += turn


@compiled(**INLINE_FAST)
def _turn_helix(z, angle):
    """Rotate the phase of a cell's helix by an angle: p' = p cos + q sin, q' = q cos - p sin."""
    c = cos(angle)
    s = sin(angle)
    sine = z[HELIX_SINE]
    cosine = z[HELIX_COSINE]
    z[HELIX_SINE] = c * sine + s * cosine
    z[HELIX_COSINE] = c * cosine - s * sine


@compiled(**INLINE_FAST)
def _fill_jacobian(jacobian, derivatives, z, angle, t):
    """Fill F = df/dz (n, n) for a step of t [s], from its `Derivatives` and the state z after it.

    The helix has turned by `angle` [rad], whose derivative by ln w is the angle itself. Only
    entries that may differ from the unit matrix are written.
    """
    _, by_heading, by_u, by_parameters = derivatives
    for row in range(HEADING + 1):  # x, y and the heading
        jacobian[row, HEADING] = by_heading[row]
        jacobian[row, TURN_BIAS] = by_u[row]
        for p in range(len(by_parameters)):
            jacobian[row, LN_A + p] = by_parameters[p][row]
    jacobian[X, FLOW_X] = t
    jacobian[Y, FLOW_Y] = t
    if angle > 0:
        c = cos(angle)
        s = sin(angle)
        jacobian[HELIX_SINE, HELIX_SINE] = c
        jacobian[HELIX_SINE, HELIX_COSINE] = s
        jacobian[HELIX_SINE, LN_FREQUENCY] = angle * z[HELIX_COSINE]
        jacobian[HELIX_COSINE, HELIX_SINE] = -s
        jacobian[HELIX_COSINE, HELIX_COSINE] = c
        jacobian[HELIX_COSINE, LN_FREQUENCY] = -angle * z[HELIX_SINE]


@compiled(**INLINE_FAST)
def _propagate(cov, jacobian, product):
    """Replace P by F P F', which is symmetric to the last bit.

    `product` (n, n) is a working array for F P.
    """
    states = cov.shape[0]
    for j in range(states):
        for k in range(states):
            product[j, k] = 0.0
        for m in range(states):
            for k in range(states):
                product[j, k] += jacobian[j, m] * cov[m, k]
    for j in range(states):
        for k in range(j + 1):
            total = 0.0
            for m in range(states):
                total += product[j, m] * jacobian[k, m]
            cov[j, k] = total
            cov[k, j] = total


@compiled(**INLINE_FAST)
def _add_walk(model, i, cov, noise_scale, t):
    """Add the random walks Q t to the variances. The walk of the pose is scaled like the noise."""
    for k in range(cov.shape[0]):
        scale = 1.0
        if k <= Y:
            scale = noise_scale[POSITIONS]
        elif k == HEADING:
            scale = noise_scale[HEADINGS]
        cov[k, k] += scale * model.walk[k, i] * model.walk[k, i] * t


@compiled(**INLINE_FAST)
def _bound_heading(cov):
    """Limit the heading's variance to the one of an unknown heading, in place.

    Its covariances with the other states are scaled by the same ratio of standard deviations.
    """
    share = math.sqrt(UNKNOWN_HEADING / cov[HEADING, HEADING])
    for k in range(cov.shape[0]):
        cov[HEADING, k] *= share
        cov[k, HEADING] *= share
