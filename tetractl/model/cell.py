"""Motion of a cell under a held direction: Euler (4)-(6), held wheels, exact step of (1)-(3).

Every step maps (x, y, heading) to the same after a time t with the direction u held. Arguments
broadcast against each other: typically x, y, heading of shape (..., N), u of shape (..., 1), and
turning rates a [rad/s] and speeds v [length unit/s] of shape (N,). Angles are not wrapped.
"""

from collections.abc import Callable

import numpy as np

from tetractl.core.poses import Floats

Time = float | Floats
State = tuple[Floats, Floats, Floats]
Motion = Callable[[Floats, Floats, Floats, Floats, Floats, Floats, Time], State]


def euler(x: Floats, y: Floats, heading: Floats, u: Floats, a: Floats, v: Floats, t: Time) -> State:
    """Advance by (4)-(6), the paper's discrete model: a straight chord along the old heading.

    The last direction of a sequence therefore cannot move the last position.
    """
    return (
        x + t * v * np.cos(heading),  # (4)
        y + t * v * np.sin(heading),  # (5)
        heading + t * a * np.sin(u - heading),  # (6)
    )


def arc(x: Floats, y: Floats, heading: Floats, u: Floats, a: Floats, v: Floats, t: Time) -> State:
    """Advance with the wheel speeds of (24)-(25) computed once and held: the arc of a circle.

    The heading advances as in (6), by w = t a sin(u - heading); the chord of the arc has length
    t v sin(w/2) / (w/2) and direction heading + w/2.
    """
    half = 0.5 * t * a * np.sin(u - heading)
    chord = t * v * np.sinc(half / np.pi)
    return (
        x + chord * np.cos(heading + half),
        y + chord * np.sin(heading + half),
        heading + 2 * half,
    )


def exact(x: Floats, y: Floats, heading: Floats, u: Floats, a: Floats, v: Floats, t: Time) -> State:
    """Advance by the closed form of (1)-(3) under a held direction.

    With phi = u - heading, (3) reads d phi/dt = -a sin phi, so tan(phi/2) decays by E = exp(-a t).
    With c = cos(phi/2), s = sin(phi/2) and h = c^2 + s^2 E^2, the robot moves v (t + ln(h)/a) along
    u and v (phi - phi')/a to the right of it, where tan((phi - phi')/2) = s c (1 - E) /
    (c^2 + s^2 E). Half angles keep phi near pi exact, where 1 + cos(phi) would cancel.
    """
    half = (u - heading) / 2
    c, s = np.cos(half), np.sin(half)
    decay = np.exp(-a * t)
    turn = 2 * np.arctan2(-np.expm1(-a * t) * s * c, c * c + s * s * decay)  # phi - phi'
    fall = s * s * np.expm1(-2 * a * t)  # h - 1; ln h by log1p near h = 1, by log near h = 0
    log_h = np.where(
        fall > -0.5, np.log1p(np.maximum(fall, -0.5)), np.log(c * c + (s * decay) ** 2)
    )
    along, right = v * (t + log_h / a), v * turn / a
    cos_u, sin_u = np.cos(u), np.sin(u)
    return x + along * cos_u + right * sin_u, y + along * sin_u - right * cos_u, heading + turn


MOTIONS: dict[str, Motion] = {"euler": euler, "arc": arc, "exact": exact}
"""The planner's models by their name in the spec."""
