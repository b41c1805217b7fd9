"""Lanes advanced by one signal: the twins of `tetractl.model.cell`.

Arguments are rows (M,): position x, y; cos and sin of the heading, advanced by rotation; cos and
sin of the direction u; and what the model needs of each lane's robot, see `constants`.
"""

import math

import numpy as np
from numba import njit

from tetractl.control.kernels.numeric import (
    LARGEST_TURN,
    PART,
    arctan,
    log_from_ratio,
    mantissa,
    sincos,
    sincos_quarter,
    wrap,
)
from tetractl.model.state import Floats

EULER, ARC, EXACT, GENTLE = range(4)
MODELS = {"euler": EULER, "arc": ARC, "exact": EXACT}


def model_code(model: str, a: Floats, t: float) -> int:
    """Return the kernel for a model: GENTLE is `euler` where no step turns by over a quarter."""
    if model == "euler" and float(a.max()) * t <= math.pi / 2:
        return GENTLE
    return MODELS[model]


def constants(model: str, a: Floats, v: Floats, t: float) -> tuple[Floats, int]:
    """Return (what `advance` needs of robots with a, v (N,) over a time t, shape (3, N); pieces).

    An exact step is done in `pieces` equal pieces, each with a t <= LARGEST_TURN.
    """
    if model == "exact":
        pieces = max(1, math.ceil(float(a.max()) * t / LARGEST_TURN))
        piece = t / pieces
        return np.stack([v * piece, v / a, np.exp(-a * piece)]), pieces
    return np.stack([v * t, a * t, np.zeros_like(a)]), 1


@njit(**PART)
def euler(x, y, cos, sin, cos_u, sin_u, step, turn):
    """(4)-(6); step = T v and turn = T a, per lane."""
    for n in range(x.size):
        c, s = cos[n], sin[n]
        sw, cw = sincos(wrap(turn[n] * (sin_u[n] * c - cos_u[n] * s)))
        x[n] += step[n] * c
        y[n] += step[n] * s
        cos[n] = c * cw - s * sw
        sin[n] = s * cw + c * sw


@njit(**PART)
def gentle(x, y, cos, sin, cos_u, sin_u, step, turn):
    """(4)-(6) with turn <= pi/2."""
    for n in range(x.size):
        c, s = cos[n], sin[n]
        sw, cw = sincos_quarter(turn[n] * (sin_u[n] * c - cos_u[n] * s))
        x[n] += step[n] * c
        y[n] += step[n] * s
        cos[n] = c * cw - s * sw
        sin[n] = s * cw + c * sw


@njit(**PART)
def arc(x, y, cos, sin, cos_u, sin_u, step, turn):
    """Wheel speeds (24)-(25) held; step = T v and turn = T a, per lane."""
    for n in range(x.size):
        c, s = cos[n], sin[n]
        half = 0.5 * turn[n] * (sin_u[n] * c - cos_u[n] * s)
        sw, cw = sincos(wrap(half))
        flat = abs(half) < 1e-9
        chord = step[n] * ((1.0 if flat else sw) / (1.0 if flat else half))
        c, s = c * cw - s * sw, s * cw + c * sw  # along the chord
        x[n] += chord * c
        y[n] += chord * s
        cos[n] = c * cw - s * sw
        sin[n] = s * cw + c * sw


@njit(**PART)
def exact(x, y, cos, sin, cos_u, sin_u, step, radius, decay):
    """Closed form of (1)-(3); step = t v, radius = v/a and decay = E = exp(-a t), per lane.

    The three quotients share one division.
    """
    for n in range(x.size):
        cu, su, e = cos_u[n], sin_u[n], decay[n]
        c = cu * cos[n] + su * sin[n]  # cos phi
        s = su * cos[n] - cu * sin[n]
        near, far = 1 + c, (1 - c) * e
        d = near + far * e  # D
        across = near + far
        m, k = mantissa(0.5 * d)
        m1 = m + 1
        inverse = 1 / (d * m1 * across)
        log_half_d = log_from_ratio((m - 1) * (inverse * d * across), k)
        half_turn = arctan(s * (1 - e) * (inverse * d * m1))
        along = step[n] + radius[n] * log_half_d
        right = 2 * radius[n] * half_turn
        x[n] += along * cu + right * su
        y[n] += along * su - right * cu
        over_d = inverse * m1 * across
        c, s = (near - far * e) * over_d, 2 * e * s * over_d  # of phi'
        unit = 1.5 - 0.5 * (c * c + s * s)  # near phi = pi, rounding off the circle would grow
        c, s = c * unit, s * unit
        cos[n] = cu * c + su * s
        sin[n] = su * c - cu * s


@njit(**PART)
def advance(model, pieces, x, y, cos, sin, cos_u, sin_u, f0, f1, f2):
    """Advance every lane by one signal."""
    if model == GENTLE:
        gentle(x, y, cos, sin, cos_u, sin_u, f0, f1)
    elif model == EULER:
        euler(x, y, cos, sin, cos_u, sin_u, f0, f1)
    elif model == ARC:
        arc(x, y, cos, sin, cos_u, sin_u, f0, f1)
    else:
        for _ in range(pieces):
            exact(x, y, cos, sin, cos_u, sin_u, f0, f1, f2)
