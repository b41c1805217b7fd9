"""Tests of swimming cells: the helix, the field, walls, and events such as a division."""

import math

import numpy as np
import pytest
from testkit.trials import experiment

from tetractl.core.setup import Bounds
from tetractl.model.swimmers import Swimmers, bodies, compute_speed_factor, compute_walls_um

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
    assert compute_speed_factor(20.0) == 1.0
    assert compute_speed_factor(21.0) == pytest.approx(1.037, abs=0.003)
    with pytest.raises(ValueError, match="60 C"):
        compute_speed_factor(60.0)


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


@pytest.mark.parametrize("celsius", [0.0, 13.0, 40.0])
def test_speeds_follow_arrhenius_from_0_to_40_degrees(celsius):
    kelvin = 273.15 + celsius
    expected = math.exp(0.27 / 8.617e-5 * (1 / 293.15 - 1 / kelvin))
    assert compute_speed_factor(celsius) == pytest.approx(expected)
    for outside in (-0.1, 40.1):
        with pytest.raises(ValueError, match="give 0 to 40"):
            compute_speed_factor(outside)


def test_cells_vary_as_cultures_do_but_no_size_by_more_than_half_of_its_mean():
    drawn = Swimmers.drawn(np.random.default_rng(91), 20_000)
    for values, mean in ((drawn.width, 26.3), (drawn.helix_um, 8.0), (drawn.length, 52.3)):
        assert 0.5 * mean <= values.min() < values.max() <= 1.5 * mean
        assert values.mean() == pytest.approx(mean, rel=0.02)
    assert not drawn.resting.any()
    assert np.median(drawn.a) == pytest.approx(4.0, rel=0.02)
    assert np.std(np.log(drawn.a)) == pytest.approx(0.25, rel=0.02)
    assert np.ptp(drawn.heading) == pytest.approx(math.tau, rel=0.01)
    assert drawn.phase.min() >= 0


def test_a_body_is_to_the_left_of_its_axis_at_first_and_above_it_a_quarter_later():
    swimmers = cells(4, speed=300.0, helix_um=8.0, helix_hz=2.0, x=10.0, y=20.0, depth=5.0)
    swimmers.phase[:] = 0.0, math.pi / 2, 0.0, math.pi / 2
    swimmers.heading[:] = 0.0, 0.0, math.pi / 2, math.pi / 2
    seen = bodies(swimmers)
    assert seen.x == pytest.approx([10, 10, 2, 10])
    assert seen.y == pytest.approx([28, 20, 20, 20])
    assert seen.height == pytest.approx([5, 13, 5, 13])
    tilt = math.atan(2 * math.pi * 2.0 * 8.0 / 300.0)
    assert seen.tilt == pytest.approx([tilt, 0, tilt, 0])  # it swings upwards first
    axis = np.array([0, -tilt, math.pi / 2, math.pi / 2 - tilt])
    assert seen.axis == pytest.approx(axis)


def test_walls_are_those_of_the_arena_in_micrometres():
    setup = experiment().setup  # in mm: 600 to 2200 across, 350 to 2150 upwards
    walls = compute_walls_um(setup, 30.0)
    assert walls.left == pytest.approx(600_030)
    assert walls.right == pytest.approx(2_199_970)
    assert walls.bottom == pytest.approx(350_030)
    assert walls.top == pytest.approx(2_149_970)
    assert compute_walls_um(setup).left == pytest.approx(600_000)


def test_what_happens_to_copies_and_parts_does_not_happen_to_the_cells():
    swimmers = cells(3, x=1.0)
    swimmers.x[:] = 1.0, 2.0, 3.0
    copied = swimmers.copy()
    copied.x[:] = 9.0
    laid_out = swimmers.to_cell_arrays()
    laid_out.heading[:] = 9.0
    assert swimmers.x.tolist() == [1, 2, 3]
    assert not swimmers.heading.any()
    kept = swimmers.select(np.array([True, False, True]))
    assert (kept.x.tolist(), len(kept)) == ([1, 3], 2)
    joined = kept.joined(copied)
    assert joined.x.tolist() == [1, 3, 9, 9, 9]
    assert len(joined.resting) == 5


def test_resting_cells_drift_only_until_they_swim_again():
    swimmers = cells(2, speed=300.0)
    swimmers.set_resting(1)
    swum(swimmers, 0.1, drift=(40.0, -20.0))
    assert swimmers.x == pytest.approx([34, 4])
    assert swimmers.y == pytest.approx([-2, -2])
    swimmers.set_resting(1, False)
    swum(swimmers, 0.1)
    assert swimmers.x == pytest.approx([64, 34])


def test_the_cells_after_a_division_turn_aside_and_keep_the_rest_of_their_mother():
    swimmers = cells(3, seed=4)
    for seed in range(20):
        after = swimmers.divide(2, np.random.default_rng(seed))
        share = after.a[2] / (2 * swimmers.a[2])
        assert 0.3 <= share <= 0.7
        assert 0.4 <= after.heading[2] <= 0.8
        assert after.heading[3] == -after.heading[2]
        for name in ("width", "speed", "helix_um", "depth", "walk"):
            values = getattr(after, name)
            assert values[2] == values[3] == getattr(swimmers, name)[2]
        assert after.length[:2].tolist() == swimmers.length[:2].tolist()
    assert len(swimmers) == 3
    assert not swimmers.heading.any()
