"""Tests of swimming cells: the helix, the field, walls, and events such as a division."""

import math

import numpy as np
import pytest

from tetractl.core.setup import Bounds
from tetractl.model.swimmers import Swimmers, bodies, speed_factor

pytestmark = pytest.mark.slow


def cells(count=1, seed=1, **values):
    """Cells of a culture without noise, at the origin and heading along x."""
    drawn = Swimmers.drawn(np.random.default_rng(seed), count)
    drawn.heading[:] = drawn.walk[:] = drawn.bias[:] = 0.0
    for name, value in values.items():
        getattr(drawn, name)[:] = value
    return drawn


def swum(swimmers, seconds, field=(0.0, 0.0), step=0.002, **options):
    random = np.random.default_rng(0)
    for _ in range(round(seconds / step)):
        swimmers.swim(field, step, random, **options)
    return swimmers


@pytest.mark.parametrize("strength", [0.5, 1.0, 2.0])
def test_a_field_turns_the_axis_by_3_in_proportion_to_it(strength):
    """tan(d / 2) of the angle d to the field shrinks as exp(-a B / B_ref t)."""
    swimmers = swum(cells(a=3.0), 0.4, field=(0.0, strength))
    angle_left = 2 * math.atan(math.exp(-3.0 * strength * 0.4))
    assert math.pi / 2 - swimmers.heading[0] == pytest.approx(angle_left, abs=1e-3)


def test_the_body_goes_round_the_axis_and_points_along_its_way():
    swimmers = cells(speed=300.0, helix_um=8.0, helix_hz=2.5)
    dt = 0.001
    positions = []
    for _ in range(800):
        swum(swimmers, dt, step=dt)
        positions.append(bodies(swimmers))
    x = np.array([body.x[0] for body in positions])
    y = np.array([body.y[0] for body in positions])
    assert np.ptp(y) == pytest.approx(16.0, rel=0.01)  # two radii
    way = np.arctan2(np.diff(y), np.diff(x))
    axis = np.array([body.axis[0] for body in positions])
    assert np.abs(way - axis[1:]).max() < 0.02
    tilt = math.atan(2 * math.pi * 2.5 * 8.0 / 300.0)  # 0.40 rad, as in the notes of the doc
    assert np.abs(axis).max() == pytest.approx(tilt, abs=0.01)


def test_a_cell_slides_along_a_wall_until_it_is_turned_away():
    swimmers = cells(speed=300.0, heading=math.radians(60), a=5.0)
    random = np.random.default_rng(0)
    for _ in range(1000):
        swimmers.swim((0.0, 0.0), 0.002, random, walls=Bounds(-100.0, -1e6, 100.0, 1e6))
        assert abs(swimmers.x[0]) <= 100
    assert swimmers.x[0] == 100  # it keeps what its heading has along the wall
    assert swimmers.y[0] > 500
    for _ in range(1000):
        swimmers.swim((-1.0, -0.2), 0.002, random, walls=Bounds(-1e6, -1e6, 100.0, 1e6))
    assert swimmers.x[0] < 0


def test_speeds_are_log_normal_and_grow_by_four_per_cent_a_degree():
    drawn = Swimmers.drawn(np.random.default_rng(2), 4000).speed
    assert np.median(drawn) == pytest.approx(420, rel=0.02)
    assert np.std(np.log(drawn)) == pytest.approx(0.25, rel=0.05)
    assert speed_factor(20.0) == 1.0
    assert speed_factor(21.0) == pytest.approx(1.037, abs=0.003)
    with pytest.raises(ValueError, match="60 C"):
        speed_factor(60.0)


def test_a_culture_repeats_by_its_seed_and_strangers_have_no_magnet():
    first, again = (Swimmers.drawn(np.random.default_rng(5), 6, unmagnetised=2) for _ in "ab")
    assert (first.speed == again.speed).all()
    assert (first.a[:4] > 0).all() and (first.a[4:] == 0).all()


def test_a_cell_divides_into_two_that_share_its_magnet():
    swimmers = cells(3)
    after = swimmers.divide(1, np.random.default_rng(3))
    assert len(swimmers) == 3 and len(after) == 4
    assert after.a[1] + after.a[3] == pytest.approx(2 * swimmers.a[1])
    assert (after.length[[1, 3]] == 0.8 * swimmers.length[1]).all()
    assert after.x[1] == after.x[3] and after.heading[1] != after.heading[3]
    assert (after.a[[0, 2]] == swimmers.a[[0, 2]]).all()
