"""Update what a filter knows about a robot by a measured pose: a Kalman filter's update step.

For a robot in the state z (`filter_state`), a camera measures, with noise of the variances R,

    h(z) = ( x - p sin theta,   y + p cos theta,   theta + m + atan(w q / v) ).

For robots on wheels, p = q = 0. The Kalman filter's update by the pose y is

    z <- z + K (y - h(z)),    K = P H' / (H P H' + R),    H = dh/dz.

The update is made for one number after the other, so that no matrix is inverted: H P H' + R is a
number, and H is a row. P is updated in Joseph's form, (1 - K H) P (1 - K H)' + K R K'. The shorter
form P - K H P would fail: after a long time without a fit, P is many orders of magnitude larger
than R, and rounding errors would leave a matrix that is no covariance.
"""

import math

import numpy as np

from tetractl.control.estimation.kernels.filter_motion import parameters_of
from tetractl.control.estimation.kernels.filter_state import (
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
from tetractl.control.search.kernels.elementary import atan, cos, exp, log, sin
from tetractl.model.motion.polynomials import wrap
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import INLINE_FAST, inlined

wrapped = inlined(wrap)


@compiled(**INLINE_FAST)
def measure(model, i, z, cov, noise_scale, pose, scratch):
    """Update a hypothesis about robot i by a measured pose, unless the pose is an outlier.

    Args:
        model: The assumptions about the robots, a `FilterModel`.
        i: Index of the robot.
        z: The state (STATES,), which changes.
        cov: The covariance P (n, n), which changes.
        noise_scale: Ratios (2,) of the bank, by which the variances R are multiplied.
        pose: The measured x, y [length unit] and heading [rad], (3,).
        scratch: A `FilterScratch`. Its `innovation` (3,) is filled with y - h(z) along and across
            the course and of the heading, each divided by its standard deviation.

    Returns:
        The ln of the pose's likelihood. An outlier, or a pose with NaN, changes neither z nor P,
        and has the likelihood of a pose at the gate.
    """
    _expect(model, i, z, scratch.expected, scratch.slopes)
    distance2, ln_variances = _compare(model, i, z, cov, noise_scale, pose, scratch)
    if not distance2 <= GATE:  # nor is a pose that is no number
        return -0.5 * (GATE + ln_variances)
    off = scratch.off
    ln_likelihood = 0.0
    for j in range(3):
        total = _correct(z, cov, j, scratch)
        ln_likelihood -= 0.5 * (off[j] * off[j] / total + log(total))
    for k in range(cov.shape[0]):
        for m in range(k):
            mean = 0.5 * (cov[k, m] + cov[m, k])
            cov[k, m] = mean
            cov[m, k] = mean
    return ln_likelihood


@compiled(**INLINE_FAST)
def _expect(model, i, z, expected, slopes):
    """Compute the pose h(z) (3,) that a camera would measure, and its `slopes` H (3, n).

    Only the slopes that can differ from 0 are written.
    """
    expected[0] = z[X]
    expected[1] = z[Y]
    expected[2] = z[HEADING] + z[MARKER_BIAS]
    slopes[0, X] = 1.0
    slopes[1, Y] = 1.0
    slopes[2, HEADING] = 1.0
    slopes[2, MARKER_BIAS] = 1.0
    if model.helix_rad_s == 0:
        return
    c = cos(z[HEADING])
    s = sin(z[HEADING])
    sine = z[HELIX_SINE]
    speed = parameters_of(model, i, z)[1]
    w_over_v = model.helix_rad_s * exp(z[LN_FREQUENCY]) / (speed + 1e-300)
    sideways = w_over_v * z[HELIX_COSINE]  # sideways speed over v
    atan_slope = 1 / (1 + sideways * sideways)
    expected[0] -= s * sine
    expected[1] += c * sine
    expected[2] += atan(sideways)
    slopes[0, HEADING] = -c * sine
    slopes[0, HELIX_SINE] = -s
    slopes[1, HEADING] = -s * sine
    slopes[1, HELIX_SINE] = c
    slopes[2, HELIX_COSINE] = w_over_v * atan_slope
    slopes[2, LN_SPEED] = -sideways * atan_slope
    slopes[2, LN_FREQUENCY] = sideways * atan_slope


@compiled(**INLINE_FAST)
def _compare(model, i, z, cov, noise_scale, pose, scratch):
    """Compare a measured pose (3,) with the pose that is expected under a hypothesis.

    The function fills `off`, `variance` and `innovation` of the scratch arrays.

    Returns:
        The sum of the squared innovations, and the sum of the ln of their variances H P H' + R.
    """
    off = scratch.off
    variance = scratch.variance
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
        total = _multiply(cov, scratch.slopes[j], scratch.p_h) + variance[j]
        distance2 += off[j] * off[j] / total
        ln_variances += log(total)
        innovation[j] = off[j] / math.sqrt(total)
    along = c * innovation[X] + s * innovation[Y]
    across = c * innovation[Y] - s * innovation[X]
    innovation[ALONG] = along
    innovation[ACROSS] = across
    return distance2, ln_variances


@compiled(**INLINE_FAST)
def _multiply(cov, h, p_h):
    """Compute P h for a row h (n,) of the matrix H into `p_h` (n,), and return h P h'."""
    total = 0.0
    for k in range(h.size):
        p_h[k] = 0.0
        for m in range(h.size):
            p_h[k] += cov[k, m] * h[m]
        total += h[k] * p_h[k]
    return total


@compiled(**INLINE_FAST)
def _correct(z, cov, j, scratch):
    """Correct z and P by the measured number j, and return its variance H P H' + R before that.

    j is 0 for x, 1 for y and 2 for the heading. The differences `off` of the later numbers from
    their expectation change accordingly.
    """
    off = scratch.off
    slopes = scratch.slopes
    p_h = scratch.p_h
    states = p_h.size
    variance = scratch.variance[j]
    total = _multiply(cov, slopes[j], p_h) + variance
    for later in range(j + 1, 3):
        for m in range(states):
            off[later] -= slopes[later, m] * p_h[m] * (off[j] / total)
    for k in range(states):
        gain = p_h[k] / total
        z[k] += gain * off[j]
        for m in range(states):  # row k of (1 - K H) P
            cov[k, m] -= gain * p_h[m]
        row_h = 0.0  # that row times H'
        for m in range(states):
            row_h += cov[k, m] * slopes[j, m]
        for m in range(states):
            cov[k, m] += (variance * gain - row_h) * (p_h[m] / total)
    return total
