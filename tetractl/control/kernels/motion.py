"""Robots advanced by one signal: the twins of `tetractl.model.cell`.

Arguments are the rows of robot i in arrays (N, P): position x, y; cos and sin of the heading,
advanced by rotation. Then cos and sin of the direction u (P,), the same for every robot, and the
numbers that the model needs of this robot, see `constants`.
"""

import math

import numpy as np
from numba import njit

from tetractl.control.kernels.math import (
    LARGEST_TURN,
    PART,
    arctan,
    log_from_ratio,
    mantissa,
    sincos,
    sincos_quarter,
    wrap,
)
from tetractl.control.kernels.obstacles import in_rectangle
from tetractl.core.poses import Floats

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
def euler(x, y, cos, sin, cos_u, sin_u, i, step, turn):
    """(4)-(6); step = T v and turn = T a."""
    for n in range(cos_u.size):
        c, s = cos[i, n], sin[i, n]
        sw, cw = sincos(wrap(turn * (sin_u[n] * c - cos_u[n] * s)))
        x[i, n] += step * c
        y[i, n] += step * s
        cos[i, n] = c * cw - s * sw
        sin[i, n] = s * cw + c * sw


@njit(**PART)
def gentle(x, y, cos, sin, cos_u, sin_u, i, step, turn):
    """(4)-(6) with turn <= pi/2."""
    for n in range(cos_u.size):
        c, s = cos[i, n], sin[i, n]
        sw, cw = sincos_quarter(turn * (sin_u[n] * c - cos_u[n] * s))
        x[i, n] += step * c
        y[i, n] += step * s
        cos[i, n] = c * cw - s * sw
        sin[i, n] = s * cw + c * sw


@njit(**PART)
def gentle_past_one(x, y, cos, sin, cos_u, sin_u, i, step, turn, boxes, hits):
    """`gentle`, counting who ends in the only rectangle: the paper's own case, in one loop."""
    left, bottom, right, top = boxes[0, 0], boxes[0, 1], boxes[0, 2], boxes[0, 3]
    for n in range(cos_u.size):
        c, s = cos[i, n], sin[i, n]
        sw, cw = sincos_quarter(turn * (sin_u[n] * c - cos_u[n] * s))
        new_x, new_y = x[i, n] + step * c, y[i, n] + step * s
        x[i, n], y[i, n] = new_x, new_y
        cos[i, n] = c * cw - s * sw
        sin[i, n] = s * cw + c * sw
        hits[i, n] += 1.0 if in_rectangle(new_x, new_y, left, bottom, right, top) <= 0 else 0.0


@njit(**PART)
def coast_past_one(x, y, cos, sin, i, step, boxes, hits):
    """The last step of `gentle_past_one`: its signal cannot move the last position, (4)-(5)."""
    left, bottom, right, top = boxes[0, 0], boxes[0, 1], boxes[0, 2], boxes[0, 3]
    for n in range(x.shape[1]):
        new_x, new_y = x[i, n] + step * cos[i, n], y[i, n] + step * sin[i, n]
        x[i, n], y[i, n] = new_x, new_y
        hits[i, n] += 1.0 if in_rectangle(new_x, new_y, left, bottom, right, top) <= 0 else 0.0


@njit(**PART)
def arc(x, y, cos, sin, cos_u, sin_u, i, step, turn):
    """Wheel speeds (24)-(25) held; step = T v and turn = T a."""
    for n in range(cos_u.size):
        c, s = cos[i, n], sin[i, n]
        half = 0.5 * turn * (sin_u[n] * c - cos_u[n] * s)
        sw, cw = sincos(wrap(half))
        flat = abs(half) < 1e-9
        chord = step * ((1.0 if flat else sw) / (1.0 if flat else half))
        c, s = c * cw - s * sw, s * cw + c * sw  # along the chord
        x[i, n] += chord * c
        y[i, n] += chord * s
        cos[i, n] = c * cw - s * sw
        sin[i, n] = s * cw + c * sw


@njit(**PART)
def exact(x, y, cos, sin, cos_u, sin_u, i, step, radius, e):
    """Closed form of (1)-(3); step = t v, radius = v/a and e = E = exp(-a t).

    The three quotients share one division.
    """
    for n in range(cos_u.size):
        cu, su = cos_u[n], sin_u[n]
        c = cu * cos[i, n] + su * sin[i, n]  # cos phi
        s = su * cos[i, n] - cu * sin[i, n]
        near, far = 1 + c, (1 - c) * e
        d = near + far * e  # D
        across = near + far
        m, k = mantissa(0.5 * d)
        m1 = m + 1
        inverse = 1 / (d * m1 * across)
        log_half_d = log_from_ratio((m - 1) * (inverse * d * across), k)
        half_turn = arctan(s * (1 - e) * (inverse * d * m1))
        along = step + radius * log_half_d
        right = 2 * radius * half_turn
        x[i, n] += along * cu + right * su
        y[i, n] += along * su - right * cu
        over_d = inverse * m1 * across
        c, s = (near - far * e) * over_d, 2 * e * s * over_d  # of phi'
        unit = 1.5 - 0.5 * (c * c + s * s)  # near phi = pi, rounding off the circle would grow
        c, s = c * unit, s * unit
        cos[i, n] = cu * c + su * s
        sin[i, n] = su * c - cu * s


@njit(**PART)
def advance(model, pieces, x, y, cos, sin, cos_u, sin_u, i, c0, c1, c2):
    """Advance robot i of every particle by one signal; c0, c1, c2 are its `constants`."""
    if model == GENTLE:
        gentle(x, y, cos, sin, cos_u, sin_u, i, c0, c1)
    elif model == EULER:
        euler(x, y, cos, sin, cos_u, sin_u, i, c0, c1)
    elif model == ARC:
        arc(x, y, cos, sin, cos_u, sin_u, i, c0, c1)
    else:
        for _ in range(pieces):
            exact(x, y, cos, sin, cos_u, sin_u, i, c0, c1, c2)
