"""Tests of telling swimmers from beads by successive displacements."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tetractl_microscope.tracks.onward import (
    Persistence,
    hardly_any_keeps_direction,
    measure_persistence,
    track_keeps_direction,
)


def zigzag(turn, count=30):
    """A path of equal steps that turns by an angle to and fro [rad]."""
    headings = np.where(np.arange(count) % 2, turn / 2, -turn / 2)
    steps = np.column_stack([np.cos(headings), np.sin(headings)])
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


@given(st.floats(0.0, math.pi), st.floats(0.01, 100.0), st.floats(0.0, math.tau))
def test_the_similarity_is_the_cosine_of_the_turns_in_any_unit_and_direction(turn, unit, rotation):
    cos, sin = math.cos(rotation), math.sin(rotation)
    places = unit * zigzag(turn) @ np.array([[cos, sin], [-sin, cos]])
    found = measure_persistence(places, 1)
    assert found.product_sum / found.product_max == pytest.approx(math.cos(turn), abs=1e-6)


def test_displacements_of_several_steps_are_compared_with_those_that_follow():
    found = measure_persistence(zigzag(math.pi / 2), 2)
    assert found.product_sum == pytest.approx(found.product_max)
    corner = np.array([(0, 0), (1, 0), (2, 0), (2, 1), (2, 2)], float)
    found = measure_persistence(corner, 2)
    assert (found.product_sum, found.product_max) == (0.0, 4.0)


@pytest.mark.parametrize(("alike", "goes_on"), [(0.5, True), (0.49, False), (-1.0, False)])
def test_an_object_goes_on_from_a_mean_cosine_of_a_half(alike, goes_on):
    assert Persistence(3 * alike, 3.0).keeps_direction is goes_on


@pytest.mark.parametrize(
    ("count", "of", "hardly_any"),
    [(0, 3, True), (1, 3, False), (1, 4, True), (2, 5, False), (1, 1, False), (0, 1, True)],
)
def test_fewer_than_a_third_may_go_on_by_chance(count, of, hardly_any):
    assert hardly_any_keeps_direction([True] * count + [False] * (of - count)) is hardly_any


def bead(count, seed):
    return np.cumsum(np.random.default_rng(seed).normal(0.0, 2.0, (count, 2)), axis=0)


@pytest.mark.parametrize("seed", range(8))
def test_a_bead_does_not_go_on_and_goes_on_if_it_is_carried(seed):
    times = np.arange(100) / 10
    assert not track_keeps_direction(times, bead(100, seed))
    assert track_keeps_direction(times, bead(100, seed) + np.outer(times, (40.0, 0.0)))


def test_a_swimmer_whose_places_are_noisy_is_known_over_a_longer_time():
    times = np.arange(200) / 20
    noise = np.random.default_rng(3).normal(0.0, 5.0, (200, 2))
    places = np.outer(times, (60.0, 20.0)) + noise
    assert not measure_persistence(places, 1).keeps_direction
    assert track_keeps_direction(times, places)
    hours = 3600 * times  # one image in three minutes: no longer displacements are tried
    assert not track_keeps_direction(hours, places)


@pytest.mark.parametrize(("count", "known"), [(41, True), (40, False)])
def test_steps_of_equal_length_show_a_swimmer_if_there_are_40(count, known):
    """It turns by right angles at random from one image to the next."""
    random = np.random.default_rng(4)
    headings = random.integers(0, 4, count - 1) * math.pi / 2
    steps = 10 * np.column_stack([np.cos(headings), np.sin(headings)])
    places = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    assert track_keeps_direction(2.0 * np.arange(count), places) is known


@pytest.mark.parametrize(("spread", "even"), [(0.1, True), (0.25, False)])
def test_steps_whose_lengths_vary_much_show_none(spread, even):
    random = np.random.default_rng(5)
    headings = random.integers(0, 4, 80) * math.pi / 2
    lengths = 10 * (1 + spread * np.where(np.arange(80) % 2, 1, -1))
    steps = lengths[:, None] * np.column_stack([np.cos(headings), np.sin(headings)])
    places = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    assert track_keeps_direction(2.0 * np.arange(81), places) is even


@pytest.mark.parametrize("count", [3, 5, 12])
def test_a_short_track_that_goes_on_is_known_by_its_single_steps(count):
    times = np.arange(count) / 50
    assert track_keeps_direction(times, np.outer(times, (300.0, 100.0)))
    assert not track_keeps_direction(times, zigzag(math.pi, count - 1))
