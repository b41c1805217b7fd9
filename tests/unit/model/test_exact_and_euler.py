"""Tests of derivatives, compiled steps and held commands of both motions, against plain steps."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.core.registries import MOTIONS
from tetractl.model.motion.exact import rates
from tetractl.model.motion.motion import Held

EULER, EXACT = (MOTIONS.load(name) for name in ("euler", "exact"))
BOTH = pytest.mark.parametrize("motion", [EULER, EXACT], ids=["euler", "exact"])
angles = st.floats(-math.pi, math.pi)
turns = st.floats(0.1, 8)
speeds = st.floats(1, 400)
times = st.floats(0.02, 0.6)


def stepped(motion, heading, u, a, v, t):
    """The step dx, dy, dheading of one robot."""
    numbers = (np.array([float(value)]) for value in (0.0, 0.0, heading, u, a, v))
    x, y, after = motion.step(*numbers, t)
    return np.array([x[0], y[0], after[0] - heading])


@BOTH
@given(heading=angles, u=angles, a=turns, v=speeds, t=times)
def test_derivatives_are_those_of_differences(motion, heading, u, a, v, t):
    trigonometry = math.cos(heading), math.sin(heading), math.cos(u), math.sin(u)
    step, by_heading, by_u, (by_ln_a, by_ln_v) = motion.lanes.differentiate(
        *trigonometry, (a, v), t
    )
    assert step == pytest.approx(stepped(motion, heading, u, a, v, t), abs=1e-6 * v)

    def slope(change, own=0.0):
        h = 1e-5
        ahead, behind = (stepped(motion, *change(by), t) for by in (h, -h))
        return (ahead - behind) / (2 * h) + np.array([0.0, 0.0, own])

    near = {"abs": 2e-4 * (1 + v * t), "rel": 1e-4}
    assert by_heading == pytest.approx(slope(lambda h: (heading + h, u, a, v), own=1.0), **near)
    assert by_u == pytest.approx(slope(lambda h: (heading, u + h, a, v)), **near)
    assert by_ln_a == pytest.approx(slope(lambda h: (heading, u, a * math.exp(h), v)), **near)
    assert by_ln_v == pytest.approx(slope(lambda h: (heading, u, a, v * math.exp(h))), **near)


@BOTH
@given(heading=angles, u=angles, a=turns, v=speeds, t=times)
def test_the_pieces_of_a_compiled_step_are_the_step(motion, heading, u, a, v, t):
    lanes = motion.lanes.of(np.array([[9.0, 7.0], [a, v]]), t)
    row = lanes.rows[1]
    assert len(row) == motion.lanes.size
    x, y, c, s = 30.0, -20.0, math.cos(heading), math.sin(heading)
    for _ in range(lanes.pieces):
        x, y, c, s = motion.lanes.advance(x, y, c, s, math.cos(u), math.sin(u), row)
    dx, dy, turned = stepped(motion, heading, u, a, v, t)
    assert (x - 30.0, y + 20.0) == pytest.approx((dx, dy), abs=1e-8 * (1 + v))
    assert (c, s) == pytest.approx(
        (math.cos(heading + turned), math.sin(heading + turned)), abs=1e-8
    )


@BOTH
@pytest.mark.parametrize("robot", [0, 1, 2])
def test_every_robot_has_pieces_enough_however_slowly_the_others_turn(motion, robot):
    a, v, t = np.array([1.0, 9.0, 4.0]), np.array([100.0, 200.0, 300.0]), 1.5
    lanes = motion.lanes.of(np.column_stack([a, v]), t)
    heading, u = 0.3, 2.9
    x, y, c, s = 0.0, 0.0, math.cos(heading), math.sin(heading)
    for _ in range(lanes.pieces):
        row = lanes.rows[robot]
        x, y, c, s = motion.lanes.advance(x, y, c, s, math.cos(u), math.sin(u), row)
    dx, dy, turned = stepped(motion, heading, u, a[robot], v[robot], t)
    assert (x, y) == pytest.approx((dx, dy), abs=1e-7)
    assert math.cos(heading + turned) == pytest.approx(c, abs=1e-8)


def held_by(motion, heading, u, a, v, t):
    """Where a robot is a time after it received a direction."""
    held = Held(
        direction=np.array([u]),
        turning=np.array([a * math.sin(u - heading)]),
        course=np.array([heading]),
        moving=np.array([1.0]),
    )
    start = (np.array([value]) for value in (5.0, 6.0, heading))
    x, y, after = motion.hold(*start, held, np.array([a]), np.array([v]), np.array([[t]]))
    return np.array([x[0, 0] - 5.0, y[0, 0] - 6.0, after[0, 0] - heading])


@BOTH
@given(heading=angles, u=angles, a=turns, v=speeds, t=times)
def test_a_command_that_is_held_for_a_period_is_a_step(motion, heading, u, a, v, t):
    expected = stepped(motion, heading, u, a, v, t)
    assert held_by(motion, heading, u, a, v, t) == pytest.approx(expected, abs=1e-9 * (1 + v))


@given(heading=angles, u=angles, a=turns, v=speeds, t=times)
def test_a_fraction_of_a_euler_step_is_that_fraction_of_its_chord_and_turn(heading, u, a, v, t):
    whole = held_by(EULER, heading, u, a, v, t)
    assert held_by(EULER, heading, u, a, v, t / 4) == pytest.approx(whole / 4)


@given(heading=angles, u=angles, a=turns, v=speeds)
def test_the_rates_are_those_of_the_equations_1_to_3(heading, u, a, v):
    expected = v * math.cos(heading), v * math.sin(heading), a * math.sin(u - heading)
    ours = rates(np.array([heading]), u, np.array([a]), np.array([v]))
    assert [float(np.ravel(part)[0]) for part in ours] == pytest.approx(expected, abs=1e-9)
    t = 1e-6
    assert stepped(EXACT, heading, u, a, v, t) / t == pytest.approx(expected, abs=1e-2, rel=1e-3)
