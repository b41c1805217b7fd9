"""How a filter of `tetractl.control.estimation.filter` predicts one hypothesis: z and P.

A robot that follows a direction u moves for a short time t [s] by

    z <- f(z, u, t),    P <- F P F' + Q t,    F = df/dz.

The motion's own step f and its slopes are those of the planner (`tetractl.model.motion.exact`),
with the turning rate of `tetractl.model.motion.turn_rate`.

Wheels that lag by T have a swing r, their turning rate over a, and a pace g, their speed over v.
Their host assumes a lag of T_h, with which it computes the swing r_h, and sends the turning rate
that (3) gives for the heading psi = theta + T_h a r_h, in which the robot would come to rest if
that were true. So psi follows (3), but for what the host does not know:

    dpsi/dt = a sin(u + beta - psi) + a (r - r_h),

where r_h is sin(u + beta - psi) itself if the host neglects the lag, T_h = 0. In a short time, psi
turns by `rest_turn` if it begins half of the second term's integral further on. The wheels follow
the mean of the rate sent: r approaches w = rest_turn / (a t) and g approaches 1, or 0 for a robot
that stops, with the time constant T, and r_h approaches w with T_h:

    r' = w + (r - w) exp(-t/T),    turn = rest_turn + a T (r - w) (1 - exp(-t/T)),
    g' = 1 + (g - 1) exp(-t/T),    way = v (t + T (g - 1) (1 - exp(-t/T))),

with g' = g exp(-t/T) and way = v T g (1 - exp(-t/T)) for a robot that stops. The path is the arc of
this turn and way, whose chord points to the heading in its middle.
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
from tetractl.model.motion.turn_rate import RobotParameters, by_turning, held, times, turning
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import INLINE_FAST, inlined

differentiate = inlined(exact.differentiate)
rolled = inlined(wheel_equations.rolled)
turn_rate = inlined(turning)
held_turn_rate = inlined(held)
with_turning = inlined(by_turning)
scaled = inlined(times)

STILL_PACE = 1e-3
"""Pace below which a robot that was stopped counts as standing."""
LEAST_LAG_S = 1e-3
"""Minimum lag of wheels whose host assumes another one [s]."""
SUBSTEP_S = 0.025
"""Longest step between two additions of random walks [s]."""
SUBSTEPS_MAX = 4000
"""Greatest number of such steps: beyond 100 s without a command they are longer."""
NO_CHANGE = (0.0, 0.0, 0.0)
"""Of x, y and the heading."""
AT_REST = NO_CHANGE, (0.0, 0.0, 1.0), NO_CHANGE, (NO_CHANGE,) * len(RobotParameters._fields)
"""`Derivatives` of a robot at rest: it does not move, and keeps its heading."""
UNKNOWN_HEADING = math.pi * math.pi / 3
"""Variance of a heading of which nothing is known [rad2].

Without this limit, the linearised variance of a robot that drives against its direction grows
without bound, until the covariance is invalid because of rounding.
"""


@compiled(**INLINE_FAST)
def stands(u):
    """Return whether a direction is none: a robot that follows it stands."""
    return math.isnan(u)


@compiled(**INLINE_FAST)
def parameters_of(model, i, z):
    """Return a [rad/s], v [length unit/s], side and saturation of robot i in a state.

    Args:
        model: The assumptions about the robots.
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
        model: What is assumed of the robots, a `FilterModel`.
        i: The robot.
        z: Its state (STATES,), which changes.
        cov: P (n, n), which changes. With None, only the state is predicted.
        u: The direction [rad]; NaN if the robot is to stand.
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
    """Return the `Derivatives` of a short step; swings and pace of lagging wheels change."""
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
    """Return by how much more the heading psi turns in a short step than its host knows.

    It is a times the integral of r - r_h, with the rate that is sent at the beginning: exactly 0 if
    the host assumes the true lag.
    """
    sent = sin_u * cos(rest_heading) - cos_u * sin(rest_heading)
    true_way = _remaining_way(z[SWING] - sent, z[LAG], t)
    host_way = _remaining_way(z[HOST_SWING] - sent, host_lag, t)
    return a * (true_way - host_way)


@compiled(**INLINE_FAST)
def _remaining_way(missing, lag, t):
    """Return the integral over a time t [s] of what is missing at first and decays with a lag."""
    if lag == 0:
        return 0.0
    return missing * lag * (1 - exp(-t / lag))


@compiled(**INLINE_FAST)
def _lagging(z, rest, rest_slopes, goal, parameters, host_lag, t):
    """Return the `Derivatives` of a short step of lagging wheels; swings and pace change.

    They follow from the derivatives of the heading in which the wheels come to rest. If that
    heading changes and a fraction `keep` of the change stays, the chord turns by half of both.
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
    way = speed * (t * goal + lag * (1 - decay) * (z[PACE] - goal))
    dx, dy = rolled(z[HEADING] + turn_half - 0.5 * turn, turn, way)
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
    """Move x, y and the heading by a step, and by the flow."""
    dx, dy, turn = derivatives[0]
    z[X] += dx + t * z[FLOW_X]
    z[Y] += dy + t * z[FLOW_Y]
    z[HEADING] += turn


@compiled(**INLINE_FAST)
def _turn_helix(z, angle):
    """Turn the helix: p' = p cos + q sin, q' = q cos - p sin."""
    c = cos(angle)
    s = sin(angle)
    sine = z[HELIX_SINE]
    cosine = z[HELIX_COSINE]
    z[HELIX_SINE] = c * sine + s * cosine
    z[HELIX_COSINE] = c * cosine - s * sine


@compiled(**INLINE_FAST)
def _fill_jacobian(jacobian, derivatives, z, angle, t):
    """Fill F = df/dz (n, n) of a step of t [s], given its `Derivatives` and the state z after it.

    The helix has turned by `angle` [rad], whose slope by ln w is the angle. Only entries that may
    differ from those of the unit matrix are written.
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
    """Replace P by F P F', symmetric to the last bit. `product` (n, n) takes F P."""
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
    """Add the random walks Q t to the variances; those of the pose are scaled as its noise is."""
    for k in range(cov.shape[0]):
        scale = 1.0
        if k <= Y:
            scale = noise_scale[POSITIONS]
        elif k == HEADING:
            scale = noise_scale[HEADINGS]
        cov[k, k] += scale * model.walk[k, i] * model.walk[k, i] * t


@compiled(**INLINE_FAST)
def _bound_heading(cov):
    """Limit the variance of the heading to that of an unknown one, and its covariances with it."""
    share = math.sqrt(UNKNOWN_HEADING / cov[HEADING, HEADING])
    for k in range(cov.shape[0]):
        cov[HEADING, k] *= share
        cov[k, HEADING] *= share
