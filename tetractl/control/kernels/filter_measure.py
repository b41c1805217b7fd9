"""How a filter of `tetractl.control.filter` updates one hypothesis by a measured pose.

Of a robot in the state z, a camera measures with noise of the variances R

    h(z) = ( x - p sin theta,   y + p cos theta,   theta + m + atan(w q / v) ),

p = q = 0 for robots on wheels. The Kalman filter's update by the pose y is

    z <- z + K (y - h(z)),    K = P H' / (H P H' + R),    H = dh/dz.

It is made for one number after the other, so that no matrix is inverted: H P H' + R is a number. P
is updated in Joseph's form, (1 - K H) P (1 - K H)' + K R K': after a long time without a fit, P is
many orders larger than R, and by rounding P - K H P would not be a covariance. The measured numbers
have few slopes each: those by the states DEPENDS_ON.
"""

import math

import numpy as np

from tetractl.control.kernels.elementary import atan, cos, exp, log, sin
from tetractl.control.kernels.filter_motion import parameters_of
from tetractl.control.kernels.filter_state import (
    ACROSS,
    ALONG,
    GATE,
    HEADING,
    HEADINGS,
    HELIX_COSINE,
    HELIX_SINE,
    LN_FREQUENCY,
    LN_SPEED,
    MARKER_BIAS,
    POSITIONS,
    X,
    Y,
)
from tetractl.model.motion.polynomials import wrap
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import INLINE_FAST, inlined

wrapped = inlined(wrap)

DEPENDS_ON = np.array(
    [
        (X, HEADING, HELIX_SINE, X, X),
        (Y, HEADING, HELIX_SINE, Y, Y),
        (HEADING, MARKER_BIAS, HELIX_COSINE, LN_SPEED, LN_FREQUENCY),
    ]
)
"""The states that measured x, y and heading depend on; the slopes by the last of x and y are 0."""
SLOPES_OF_WHEELS = 2
"""Number of columns of DEPENDS_ON that concern robots without a helix."""


@compiled(**INLINE_FAST)
def _expect(model, i, z, expected, slopes):
    """Fill the pose h(z) (3,) that a camera would measure, and its `slopes` by DEPENDS_ON; return
    the number of columns that count."""
    slopes[0, 0] = 1.0
    slopes[1, 0] = 1.0
    slopes[2, 0] = 1.0
    slopes[2, 1] = 1.0
    if model.helix_rad_s == 0:
        expected[0] = z[X]
        expected[1] = z[Y]
        expected[2] = z[HEADING] + z[MARKER_BIAS]
        slopes[0, 1] = 0.0
        slopes[1, 1] = 0.0
        return SLOPES_OF_WHEELS
    c = cos(z[HEADING])
    s = sin(z[HEADING])
    sine = z[HELIX_SINE]
    speed = parameters_of(model, i, z)[1]
    w_over_v = model.helix_rad_s * exp(z[LN_FREQUENCY]) / (speed + 1e-300)
    sideways = w_over_v * z[HELIX_COSINE]  # sideways speed over v
    atan_slope = 1 / (1 + sideways * sideways)
    expected[0] = z[X] - s * sine
    expected[1] = z[Y] + c * sine
    expected[2] = z[HEADING] + z[MARKER_BIAS] + atan(sideways)
    slopes[0, 1] = -c * sine
    slopes[1, 1] = -s * sine
    slopes[0, 2] = -s
    slopes[1, 2] = c
    slopes[2, 2] = w_over_v * atan_slope
    slopes[2, 3] = -sideways * atan_slope
    slopes[2, 4] = sideways * atan_slope
    return DEPENDS_ON.shape[1]


@compiled(**INLINE_FAST)
def measure(model, i, z, cov, noise_scale, pose, scratch):
    """Update one hypothesis of robot i by a pose (3,); return the ln of the pose's likelihood.

    `scratch.innovation` (3,) is filled with y - h(z) along and across the course and of the
    heading, over their deviations. An outlier changes nothing, and has the likelihood of a pose at
    the gate.
    """
    columns = _expect(model, i, z, scratch.expected, scratch.slopes)
    distance2, ln_variances = _compare(model, i, z, cov, noise_scale, pose, columns, scratch)
    if not distance2 <= GATE:  # nor is a pose that is no number
        return -0.5 * (GATE + ln_variances)
    off = scratch.off
    ln_likelihood = 0.0
    for j in range(3):
        total = _correct(z, cov, j, columns, scratch)
        ln_likelihood -= 0.5 * (off[j] * off[j] / total + log(total))
    for k in range(cov.shape[0]):
        for m in range(k):
            mean = 0.5 * (cov[k, m] + cov[m, k])
            cov[k, m] = mean
            cov[m, k] = mean
    return ln_likelihood


@compiled(**INLINE_FAST)
def _compare(model, i, z, cov, noise_scale, pose, columns, scratch):
    """Fill `off`, `variance` and `innovation` of the scratch arrays for a pose (3,); return the sum
    of the squared innovations, and that of the ln of their variances H P H' + R."""
    off = scratch.off
    variance = scratch.variance
    slopes = scratch.slopes
    innovation = scratch.innovation
    c = cos(z[HEADING])
    s = sin(z[HEADING])
    distance2 = 0.0
    ln_variances = 0.0
    for j in range(3):
        off[j] = pose[j] - scratch.expected[j]
        scale = noise_scale[POSITIONS]
        if j == HEADING:
            off[j] = wrapped(off[j])
            scale = noise_scale[HEADINGS]
        variance[j] = np.square(model.noise[j, i]) * scale
        total = variance[j]
        for n in range(columns):
            for m in range(columns):
                total += slopes[j, n] * cov[DEPENDS_ON[j, n], DEPENDS_ON[j, m]] * slopes[j, m]
        distance2 += off[j] * off[j] / total
        ln_variances += log(total)
        innovation[j] = off[j] / math.sqrt(total)
    along = c * innovation[X] + s * innovation[Y]
    across = c * innovation[Y] - s * innovation[X]
    innovation[ALONG] = along
    innovation[ACROSS] = across
    return distance2, ln_variances


@compiled(**INLINE_FAST)
def _correct(z, cov, j, columns, scratch):
    """Update z and P by the measured number j; return its variance H P H' + R before.

    The later numbers' differences `off` from what is expected are updated, too.
    """
    off = scratch.off
    slopes = scratch.slopes
    p_h = scratch.p_h  # P H'
    states = cov.shape[0]
    variance = scratch.variance[j]
    miss = off[j]
    for k in range(states):
        p_h[k] = 0.0
        for n in range(columns):
            p_h[k] += slopes[j, n] * cov[DEPENDS_ON[j, n], k]
    total = variance
    for n in range(columns):
        total += slopes[j, n] * p_h[DEPENDS_ON[j, n]]
    for k in range(states):
        gain = p_h[k] / total
        z[k] += gain * miss
        for m in range(states):  # row k of (1 - K H) P
            cov[k, m] -= gain * p_h[m]
        row_h = 0.0  # that row times H'
        for n in range(columns):
            row_h += cov[k, DEPENDS_ON[j, n]] * slopes[j, n]
        for m in range(states):
            cov[k, m] += (variance * gain - row_h) * (p_h[m] / total)
    for later in range(j + 1, 3):
        for n in range(columns):
            off[later] -= slopes[later, n] * p_h[DEPENDS_ON[later, n]] * (miss / total)
    return total
