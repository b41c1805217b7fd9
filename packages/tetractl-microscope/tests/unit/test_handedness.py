"""Tests of finding a mirrored or rotated image from the turning of cells."""

import math
from functools import cache

import numpy as np
import pytest
from tetractl_microscope.choice.turn_field import create_rotating_field
from tetractl_microscope.handedness import (
    Handedness,
    describe_handedness,
    describe_wrong_sides,
    find_handedness,
)

from tetractl.core.clock import SECOND

RATES = 2.5, 3.0, 3.5, 4.0, 5.0, 0.0, 4.5  # turning rates a [rad/s]; one cell has no magnet
STEP_S = 1 / 120
SEEN_S = 8.0


def field_of(direction):
    def field(times):
        directions = np.array([direction(round(time_s * SECOND)) for time_s in times])
        return np.exp(1j * directions)

    return field


def paths(direction, mirrored=False, rotated=0.0, seed=1):
    """Positions of cells that turn with the field for 8 s, as a camera sees them every 1/30 s."""
    random = np.random.default_rng(seed)
    times = np.arange(0.0, SEEN_S, STEP_S)
    field = field_of(direction)(times)
    heading = random.uniform(-3, 3, len(RATES))
    headings = []
    for acts in field:
        heading = heading + np.multiply(RATES, (acts * np.exp(-1j * heading)).imag) * STEP_S
        headings.append(heading)
    places = np.cumsum(420.0 * STEP_S * np.exp(1j * np.array(headings)), axis=0)
    places = places[::4] * np.exp(1j * rotated)
    places = places + random.normal(size=places.shape) + 1j * random.normal(size=places.shape)
    if mirrored:
        places = -places.conj()
    return [np.column_stack([times[::4], cell.real, cell.imag]) for cell in places.T]


DRIVEN = cache(create_rotating_field(3.2, 5))


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("rotated", [0.0, 0.5, -2.0])
def test_side_and_rotation_are_found(mirrored, rotated):
    turning = find_handedness(paths(DRIVEN, mirrored, rotated), field_of(DRIVEN))
    assert turning.mirrored is mirrored and turning.explained > 0.9
    assert turning.cells == len(RATES)
    turned = math.pi - rotated if mirrored else rotated
    assert abs(math.remainder(turning.turned - turned, math.tau)) < 0.05 + 3 * turning.turned_sd
    assert 0 < turning.turned_sd < 0.1
    problems, text = describe_handedness(turning)
    assert len(problems) == (mirrored or rotated != 0.0)
    words = "the image is mirrored" if mirrored else "rad off the field's direction"
    assert all(words in problem for problem in problems)
    assert ("the mirror image of the field" in text) is mirrored
    assert text.startswith(f"{100 * turning.explained:.0f} % of the turning of 7 cells")


def test_cells_of_the_field_itself_differ_in_direction_only_by_noise():
    """The standard deviation of the rotation is that among repetitions."""
    found = [find_handedness(paths(DRIVEN, seed=k), field_of(DRIVEN)) for k in range(8)]
    turned = np.array([turning.turned for turning in found])
    stated = np.median([turning.turned_sd for turning in found])
    assert stated / 3 < turned.std() < 3 * stated


def test_cells_that_do_not_follow_the_field_are_a_problem_and_so_are_too_few():
    driven = cache(create_rotating_field(3.2, 6))
    turning = find_handedness(paths(driven), field_of(create_rotating_field(2.3, 9)))
    (problem,), text = describe_handedness(turning)
    assert problem.startswith("the cells do not turn with the field")
    assert "of 7 cells" in text
    of_two = find_handedness(paths(driven)[:2], field_of(driven))
    assert of_two is None
    assert "fewer than 3 cells" in describe_handedness(of_two)[0][0]
    assert find_handedness(paths(driven)[:3], field_of(driven)).cells == 3


def turning_by(turned, sd=0.01, mirrored=False, explained=0.9):
    return Handedness(5, mirrored, turned, sd, explained)


@pytest.mark.parametrize(
    ("turned", "sd", "rotated"),
    [
        (0.0, 0.01, False),
        (0.14, 0.01, False),  # too small to matter
        (-0.14, 0.01, False),
        (0.16, 0.01, True),
        (-0.16, 0.01, True),
        (0.5, 0.16, True),  # 3.1 standard deviations
        (-0.5, 0.17, False),
        (3.1, 0.5, True),
    ],
)
def test_a_rotation_is_reported_if_it_is_large_and_certain(turned, sd, rotated):
    turning = turning_by(turned, sd)
    assert turning.rotated is rotated
    said = describe_wrong_sides(turning, "MIRRORED", "ROTATED")
    assert len(said) == rotated
    for line in said:
        assert f"{turned:+.2f} +- {1.96 * sd:.2f} rad off" in line
        assert line.endswith("ROTATED")
    assert len(describe_handedness(turning)[0]) == rotated


@pytest.mark.parametrize("turned", [0.0, 1.0])
def test_a_mirror_image_is_reported_whatever_its_rotation(turned):
    turning = turning_by(turned, mirrored=True)
    (line,) = describe_wrong_sides(turning, "MIRRORED", "ROTATED")
    assert line == "cells turn right when the field turns left: MIRRORED"
    (line,), text = describe_handedness(turning)
    assert "lab.camera.mirrored" in line
    assert text == "90 % of the turning of 5 cells is towards the mirror image of the field"


@pytest.mark.parametrize("mirrored", [False, True])
def test_no_side_is_reported_of_cells_that_do_not_follow_the_field(mirrored):
    assert describe_wrong_sides(turning_by(1.0, mirrored=mirrored, explained=0.39), "M", "R") == []
    assert (
        len(describe_wrong_sides(turning_by(1.0, mirrored=mirrored, explained=0.4), "M", "R")) == 1
    )
    (problem,), _ = describe_handedness(turning_by(1.0, mirrored=mirrored, explained=0.39))
    assert problem.startswith("the cells do not turn with the field")


def test_the_remedy_is_the_angle_of_the_camera_or_the_coils():
    (line,), text = describe_handedness(turning_by(-0.7, 0.05))
    assert "-0.70 +- 0.10 rad" in line
    assert "lab.camera.rotation" in line and "the coils' rotation" in line
    assert text.endswith("is towards the field, with an offset of -0.70 +- 0.10 rad")
