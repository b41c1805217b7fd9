"""Tests of finding a mirrored or rotated image from the turning of cells."""

import math

import numpy as np
import pytest
from tetractl_microscope.choice.turn_field import manoeuvre
from tetractl_microscope.handedness import handedness, handedness_lines

from tetractl.core.clock import SECOND

RATES = 2.5, 3.0, 3.5, 4.0, 5.0, 0.0, 4.5  # turning rates a [rad/s]; one cell has no magnet


def paths(direction, mirrored=False, rotated=0.0, seed=1):
    """Positions of cells that turn with the field for 8 s, as a camera sees them every 1/30 s."""
    random = np.random.default_rng(seed)
    paths_of_cells = []
    for a in RATES:
        heading = random.uniform(-3, 3)
        x = 0.0
        y = 0.0
        path = []
        for k in range(2400):
            heading += a * math.sin(direction(round(k / 300 * SECOND)) - heading) / 300
            x = x + 1.4 * math.cos(heading)
            y = y + 1.4 * math.sin(heading)
            place = (x + 1j * y) * np.exp(1j * rotated) + random.normal() + 1j * random.normal()
            if k % 10 == 0:
                path.append((k / 300, -place.real if mirrored else place.real, place.imag))
        paths_of_cells.append(np.array(path))
    return paths_of_cells


def field_of(direction):
    def field(times):
        directions = np.array([direction(round(time_s * SECOND)) for time_s in times])
        return np.exp(1j * directions)

    return field


@pytest.mark.long
@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("rotated", [0.0, 0.5, -2.0])
def test_side_and_rotation_are_found(mirrored, rotated):
    direction = manoeuvre(3.2, 5)
    turning = handedness(paths(direction, mirrored, rotated), field_of(direction))
    assert turning.mirrored is mirrored and turning.explained > 0.9
    turned = math.pi - rotated if mirrored else rotated
    assert abs(math.remainder(turning.turned - turned, math.tau)) < 0.05 + 3 * turning.turned_sd
    assert turning.turned_sd < 0.1
    problems, _ = handedness_lines(turning)
    assert len(problems) == (mirrored or rotated != 0.0)
    words = "the image is mirrored" if mirrored else "rad off the field's direction"
    assert all(words in problem for problem in problems)


@pytest.mark.long
def test_cells_that_do_not_follow_the_field_are_a_problem_and_so_are_too_few():
    driven = manoeuvre(3.2, 6)
    turning = handedness(paths(driven), field_of(manoeuvre(2.3, 9)))
    assert handedness_lines(turning)[0][0].startswith("the cells do not turn with the field")
    of_two = handedness(paths(driven)[:2], field_of(driven))
    assert of_two is None
    assert "fewer than 3 cells" in handedness_lines(of_two)[0][0]
