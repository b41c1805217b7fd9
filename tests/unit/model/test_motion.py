"""Tests of steps of the two motion models, against integrations and by hand.

Headings and signals u [rad], a [rad/s], v [mm/s]. phi is the angle from the heading to u.
"""

import itertools
import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.integrate import quad

from tetractl.core.registries import MOTIONS as REGISTRY

pytestmark = pytest.mark.slow

MOTIONS = {name: REGISTRY.load(name) for name in REGISTRY.builtin}
euler, exact = (MOTIONS[name].step for name in ("euler", "exact"))

ANGLES = st.floats(-10, 10)
TURNS = st.floats(0.01, 12)  # a [rad/s]
SPEEDS = st.floats(0, 500)
TIMES = st.floats(0, 3)


def stepped(motion, x, y, heading, u, a, v, t):
    """The pose (x, y, heading) of a single robot after a step of t seconds."""
    of_one_robot = [np.array([float(number)]) for number in (x, y, heading, u, a, v)]
    pose = motion(*of_one_robot, t)
    return tuple(float(part[0]) for part in pose)


def displaced(phi, a, v, t):
    """Displacement along and to the right of u, and phi': tan(phi/2) decays, the rest is quad.

    Pieces of the integral end where the angle changes quickly: about where phi is a right angle."""
    tangent = math.tan(phi / 2)

    def angle(s):
        return 2 * math.atan(tangent * math.exp(-a * s))

    at_right_angle = math.log(abs(tangent)) / a if abs(tangent) > 1 else 0.0
    quick = [at_right_angle + k / a for k in (-8, -1, 0, 1, 8)]
    ends = [0.0, *(s for s in quick if 0 < s < t), t]
    along = right = 0.0
    for begin, end in itertools.pairwise(ends):
        along += quad(lambda s: math.cos(angle(s)), begin, end, epsabs=1e-13, epsrel=1e-13)[0]
        right += quad(lambda s: math.sin(angle(s)), begin, end, epsabs=1e-13, epsrel=1e-13)[0]
    return v * along, v * right, angle(t)


@given(x=SPEEDS, y=SPEEDS, heading=ANGLES, u=ANGLES, a=TURNS, v=SPEEDS, t=TIMES)
def test_euler_is_4_to_6(x, y, heading, u, a, v, t):
    assert stepped(euler, x, y, heading, u, a, v, t) == pytest.approx(
        (
            x + t * v * math.cos(heading),
            y + t * v * math.sin(heading),
            heading + t * a * math.sin(u - heading),
        ),
        abs=1e-9,
    )


GAPS = st.just(0.0) | st.floats(-14, -1).map(lambda power: 10**power)
NEAR = st.builds(lambda gap, angle: angle - gap, GAPS, st.sampled_from((math.pi, math.pi / 2)))
PHIS = st.builds(math.copysign, GAPS | NEAR | st.floats(0, math.pi), st.sampled_from((1, -1)))


@given(phi=PHIS, turn=st.floats(-9, 2.5).map(lambda power: 10**power))
@example(phi=math.pi, turn=300.0)
@example(phi=-math.pi, turn=300.0)
@example(phi=math.pi - 1e-9, turn=20.0)
@example(phi=1e-9 - math.pi, turn=40.0)
@example(phi=math.pi - 1e-14, turn=40.0)
@example(phi=math.pi / 2, turn=20.0)
@example(phi=-0.0, turn=300.0)
def test_the_exact_step_holds_at_every_angle_and_time(phi, turn):
    """Regression: within 1e-8 of phi = pi and with a t > 18 the robot was sent to infinity."""
    a = 4.0
    v = 200.0
    t = turn / a
    along, right, phi_after = displaced(phi, a, v, t)
    x, y, heading = stepped(exact, 0, 0, 0, phi, a, v, t)
    c = math.cos(phi)
    s = math.sin(phi)
    scale = max(1.0, v * t)
    assert (x, y) == pytest.approx((along * c + right * s, along * s - right * c), abs=1e-9 * scale)
    assert phi - heading == pytest.approx(phi_after, abs=1e-9)


@given(heading=ANGLES, u=ANGLES, a=TURNS, v=SPEEDS, t=TIMES)
def test_every_motion_keeps_to_its_speed_and_turns_towards_u(heading, u, a, v, t):
    for name, motion in MOTIONS.items():
        x, y, turned = stepped(motion.step, 0, 0, heading, u, a, v, t)
        assert math.hypot(x, y) <= v * t * (1 + 1e-12) + 1e-12, name
        phi = math.remainder(u - heading, 2 * math.pi)
        assert (turned - heading) * phi >= 0, name
        if name == "exact":  # it never turns past u
            assert abs(turned - heading) <= abs(phi) + 1e-12
