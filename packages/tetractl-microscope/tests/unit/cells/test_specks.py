"""Which objects in a dish are seen to swim, and where a speck is expected."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tetractl_microscope.cells.cell import PathBlob
from tetractl_microscope.cells.specks import (
    BLOBS_FOR_VELOCITY,
    BLOBS_TO_JUDGE,
    DEVIATION_MAX,
    DISPLACEMENT_MIN,
    EXTRAPOLATION_MAX_S,
    SIZE_VARIATION_MAX,
    Speck,
    compute_median_size,
    fit_uniform_motion,
    is_swimming,
)
from tetractl_microscope.organisms import OUTLINE_FACTOR, TETRAHYMENA

LONG_UM, WIDE_UM = TETRAHYMENA.body_um
FRAME_S = 0.05
NAN = math.nan


def path(speed_um_s, count=BLOBS_TO_JUDGE, angle=0.3, aside=(), sizes=(), frame_s=FRAME_S):
    """Blobs of an object that moves straight on, each `aside` of its line [um]."""
    blobs = []
    for k in range(count):
        way = speed_um_s * frame_s * k
        off = aside[k] if k < len(aside) else 0.0
        x = 100 + way * math.cos(angle) - off * math.sin(angle)
        y = 200 + way * math.sin(angle) + off * math.cos(angle)
        long, wide = sizes[k] if k < len(sizes) else (LONG_UM, WIDE_UM)
        blobs.append(PathBlob(k * frame_s, x, y, angle, long, wide))
    return blobs


@given(angle=st.floats(0, math.tau), speed=st.floats(150, 900))
def test_what_has_the_size_of_a_cell_and_goes_straight_on_swims(angle, speed):
    assert is_swimming(path(speed, angle=angle), TETRAHYMENA)


def test_four_blobs_are_too_few_and_only_the_newest_five_count():
    assert not is_swimming(path(400, BLOBS_TO_JUDGE - 1), TETRAHYMENA)
    rests = path(0, BLOBS_TO_JUDGE)
    later = [blob._replace(seconds=blob.seconds + 1) for blob in path(400)]
    assert is_swimming([*rests, *later], TETRAHYMENA)
    assert not is_swimming(rests, TETRAHYMENA)


@pytest.mark.parametrize(("share", "is_fast"), [(0.9, False), (1.1, True)])
def test_a_swimmer_moves_by_a_part_of_its_length_and_faster_than_one_that_rests(share, is_fast):
    passed_s = (BLOBS_TO_JUDGE - 1) * FRAME_S
    assert is_swimming(path(share * DISPLACEMENT_MIN * LONG_UM / passed_s), TETRAHYMENA) == is_fast
    slow = path(share * TETRAHYMENA.slowest_um_s, frame_s=0.5)
    assert is_swimming(slow, TETRAHYMENA) == is_fast


@pytest.mark.parametrize(
    ("long", "wide", "is_cell"),
    [
        (TETRAHYMENA.long_um[1] * OUTLINE_FACTOR * 0.99, WIDE_UM, True),
        (TETRAHYMENA.long_um[1] * OUTLINE_FACTOR * 1.01, WIDE_UM, False),
        (TETRAHYMENA.long_um[0] / OUTLINE_FACTOR * 0.99, WIDE_UM, False),
        (LONG_UM, TETRAHYMENA.wide_um[1] * OUTLINE_FACTOR * 1.01, False),
        (LONG_UM, TETRAHYMENA.wide_um[0] / OUTLINE_FACTOR * 0.99, False),
    ],
)
def test_an_object_of_another_size_is_no_cell(long, wide, is_cell):
    assert is_swimming(path(400, sizes=[(long, wide)] * BLOBS_TO_JUDGE), TETRAHYMENA) == is_cell


@pytest.mark.parametrize(("share", "is_even"), [(0.9, True), (1.1, False)])
def test_an_object_whose_size_varies_is_no_cell(share, is_even):
    """Of +d, -d, +d, -d and 0, the standard deviation is 0.894 d."""
    deviation = share * SIZE_VARIATION_MAX * LONG_UM / math.sqrt(0.8)
    sizes = [(LONG_UM + sign * deviation, WIDE_UM) for sign in (1, -1, 1, -1, 0)]
    assert is_swimming(path(400, sizes=sizes), TETRAHYMENA) == is_even


def test_three_blobs_must_be_whole():
    cut = (NAN, NAN)
    whole = (LONG_UM, WIDE_UM)
    assert is_swimming(path(400, sizes=[cut, whole, whole, whole, cut]), TETRAHYMENA)
    assert not is_swimming(path(400, sizes=[cut, whole, whole, cut, cut]), TETRAHYMENA)


@pytest.mark.parametrize(("share", "is_straight"), [(0.9, True), (1.1, False)])
def test_an_object_that_strays_from_a_line_does_not_swim(share, is_straight):
    """Asides of s (1, -2, 2, -2, 1) have no trend, a sum of 0 and the mean square 14 s^2 / 5."""
    pattern = np.array([1.0, -2.0, 2.0, -2.0, 1.0])
    scale = (
        share * DEVIATION_MAX * LONG_UM / math.sqrt(14 / 5 / 2)
    )  # the mean over both coordinates
    assert is_swimming(path(400, aside=(scale * pattern).tolist()), TETRAHYMENA) == is_straight


@given(vx=st.floats(-500, 500), vy=st.floats(-500, 500))
def test_a_line_fitted_to_a_path_is_the_least_squares_one(vx, vy):
    rng = np.random.default_rng(3)
    times = np.sort(rng.uniform(0, 1, 9))
    places = np.outer(times, (vx, vy)) + rng.normal(0, 5, (9, 2))
    velocity, fitted = fit_uniform_motion(np.column_stack([times, places]))
    by_numpy = np.polyfit(times, places, 1)
    assert velocity == pytest.approx(by_numpy[0], abs=1e-6)
    assert fitted == pytest.approx(np.outer(times, by_numpy[0]) + by_numpy[1], abs=1e-6)


def test_the_usual_size_is_the_median_of_whole_blobs():
    sizes = [(10.0, 4.0), (NAN, NAN), (12.0, 8.0), (99.0, 5.0)]
    blobs = np.array([(0, 0, 0, 0, *size) for size in sizes])
    assert tuple(compute_median_size(blobs))[:2] == (12.0, 5.0)


@given(ahead_s=st.floats(0, 1))
def test_a_speck_is_expected_to_go_on_as_over_its_newest_blobs(ahead_s):
    before = path(0, 3)
    blobs = path(300, BLOBS_FOR_VELOCITY, angle=0.0)
    speck = Speck(1, [*before, *blobs])
    x, y = speck.position_at(blobs[-1].seconds + ahead_s)
    assert x == pytest.approx(blobs[-1].x + 300 * ahead_s)
    assert y == pytest.approx(200)


def test_a_speck_that_is_new_or_was_not_seen_for_a_while_is_expected_where_it_was():
    assert Speck(1, path(300, 1)).position_at(9.0) == (100, 200)
    speck = Speck(1, path(300, 4, angle=0.0), missed_s=1.1 * EXTRAPOLATION_MAX_S)
    assert speck.position_at(9.0) == pytest.approx((100 + 300 * FRAME_S * 3, 200))


def test_a_path_is_shifted_with_the_camera():
    speck = Speck(1, path(300, 3))
    before = np.array([(blob.x, blob.y) for blob in speck.path])
    speck.move_by(5, -7)
    after = np.array([(blob.x, blob.y) for blob in speck.path])
    assert after == pytest.approx(before + np.array([5, -7]))


def test_a_velocity_does_not_depend_on_where_the_path_is():
    times = np.array([0.0, 0.1, 0.3, 0.4, 0.5])
    places = np.array([(0.0, 0.0), (3.0, 1.0), (8.0, 5.0), (13.0, 4.0), (15.0, 9.0)])
    away = np.array([500.0, -900.0])
    near, fitted = fit_uniform_motion(np.column_stack([times, places]))
    far, fitted_far = fit_uniform_motion(np.column_stack([times + 1000.0, places + away]))
    assert far == pytest.approx(near)
    assert fitted_far - away == pytest.approx(fitted)


@pytest.mark.parametrize("passed_s", [0.01, 0.4])
def test_a_speck_of_two_blobs_goes_on_at_their_speed_whatever_the_rate(passed_s):
    blobs = path(200, 2, angle=0.0, frame_s=passed_s)
    x, _ = Speck(1, blobs).position_at(blobs[-1].seconds + 0.05)
    assert x == pytest.approx(blobs[-1].x + 200 * 0.05)
