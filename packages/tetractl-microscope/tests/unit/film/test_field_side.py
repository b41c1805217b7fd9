"""A film whose cells turn to the other side than its field file says is found, and said."""

import numpy as np
import pytest
from tetractl_microscope.film.field_file import read_field, side_remarks

pytestmark = pytest.mark.slow


def turned_by(field, rates=(3.0, 4.0, 5.0, 3.5)):
    """Paths (K, 3) of cells that turn towards a field for 9 s, every 1/30 s."""
    times = np.arange(0, 9, 1 / 300)
    gathered = []
    for start, a in enumerate(rates):
        heading = 1.5 * start
        headings = []
        for acts in field.at(times):
            heading += a * (acts * np.exp(-1j * heading)).imag / 300
            headings.append(heading)
        places = np.cumsum(1.4 * np.exp(1j * np.array(headings)))
        gathered.append(np.stack([times, places.real, places.imag], axis=1)[::10])
    return gathered


@pytest.mark.parametrize(
    ("clockwise", "offset", "says"),
    [
        (False, 0.0, None),
        (True, 0.0, "cells turn right where the field turns left: the directions run clockwise"),
        (False, 0.6, "cells turn to a direction +0.6"),
    ],
)
def test_the_side_of_a_field_file_is_tested_by_the_cells(tmp_path, clockwise, offset, says):
    steps = [(0.8 * k, 1.4 * k + 0.3 * (k % 3)) for k in range(12)]
    for name, off in (("field", 0.0), ("turned", offset)):
        rows = "".join(f"{t},{direction + off}\n" for t, direction in steps)
        (tmp_path / f"{name}.csv").write_text(f"time_s,direction_rad\n{rows}")
    paths = turned_by(read_field(tmp_path / "turned.csv"))
    said = side_remarks(read_field(tmp_path / "field.csv", clockwise), paths)
    assert len(said) == (says is not None)
    assert all(says in line for line in said)


def test_cells_that_the_field_does_not_turn_say_nothing(tmp_path):
    (tmp_path / "field.csv").write_text("time_s,direction_rad\n0,0\n2,2\n4,1\n")
    field = read_field(tmp_path / "field.csv")
    assert side_remarks(field, turned_by(field, rates=(0.0, 0.0, 0.0))) == ()
