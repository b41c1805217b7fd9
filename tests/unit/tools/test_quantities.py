"""Tests of distinguishing directions in degrees from directions that count turns."""

from pathlib import Path

import numpy as np
import pytest

from tetractl.core.errors import UsageError
from tetractl.tools.table.quantities import NumberColumn, name_and_unit, refuse_degrees

RANDOM = np.random.default_rng(3).uniform(-np.pi, np.pi, 200)
COUNTED_ON = {
    "a field that reverses": 6.07 + np.pi * np.arange(4),  # half turns, rounded up and down
    "a field that rotates": 1.3 * np.arange(100),
    "random directions, unwrapped": np.unwrap(RANDOM),
    "random directions around a later turn": 40 * np.pi + RANDOM,
    "a count that begins again": np.tile(0.7 * np.arange(60), 3),
    "small steps, far on": 300 + 0.05 * np.arange(50),
}
IN_DEGREES = {
    "random": np.degrees(RANDOM),
    "a field that reverses": np.tile([0.0, 180.0], 20),
    "a field that rotates, from 0 to 360": np.arange(0, 3600, 5) % 360.0,
    "a field that rotates, from -180 to 180": np.arange(0, 3600, 5) % 360.0 - 180,
    "quarter turns, each held": np.repeat([0.0, 90.0, 180.0, 270.0], 30),
    "one direction": np.array([90.0]),
}


def refuse(angles):
    column = NumberColumn("direction_rad")
    refuse_degrees(Path("field.csv"), column, range(2, len(angles) + 2), angles)


@pytest.mark.parametrize("name", COUNTED_ON)
def test_directions_that_count_turns_are_right(name):
    """Regression: the rotating field of a reproduced paper was taken for degrees."""
    refuse(COUNTED_ON[name])


@pytest.mark.parametrize("name", IN_DEGREES)
def test_directions_in_degrees_are_refused(name):
    with pytest.raises(UsageError, match=r"is more than a whole turn, which is 6.283 rad"):
        refuse(IN_DEGREES[name])


@pytest.mark.parametrize(
    ("header", "unit"),
    [
        ("w [°/s]", "deg_s"),
        ("w (degrees/second)", "deg_s"),
        ("w [rad/s]", "rad_s"),
        ("w_deg_s", "deg_s"),
        ("w_deg/s", "deg_s"),
        ("w/deg", "deg"),
        ("w [mm/sec]", "mm_s"),
        ("w [µm]", "um"),
        ("w [turns/s]", "turns_s"),  # no unit that is known
        ("w", ""),
    ],
)
def test_a_unit_may_be_spelled_in_parts(header, unit):
    """Regression: "column w [°/s] is in °_s"."""
    assert name_and_unit(header) == ("w", unit)
