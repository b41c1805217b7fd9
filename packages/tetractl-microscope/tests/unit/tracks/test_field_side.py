"""Tests of the warning about cells that turn to the other side than the field file says."""

import numpy as np
import pytest
from tetractl_microscope.handedness import find_handedness
from tetractl_microscope.sent_directions import (
    SHORT_DELAYS_S,
    check_directions,
    compute_courses,
    create_other_readings,
)
from tetractl_microscope.tracks.field_file import describe_wrong_directions, read_field

from tetractl.core.errors import UsageError

pytestmark = pytest.mark.slow


def turned_by(field, rates=(3.0, 4.0, 5.0, 3.5)):
    """Paths (K, 3) of cells that turn towards a field for 9 s, every 1/30 s."""
    times = np.arange(0, 9, 1 / 300)
    gathered = []
    for start, a in enumerate(rates):
        heading = 1.5 * start
        headings = []
        for acts in field.field_at(times):
            heading += a * (acts * np.exp(-1j * heading)).imag / 300
            headings.append(heading)
        places = np.cumsum(1.4 * np.exp(1j * np.array(headings)))
        gathered.append(np.stack([times, places.real, places.imag], axis=1)[::10])
    return gathered


@pytest.mark.parametrize(
    ("clockwise", "offset", "says"),
    [
        (False, 0.0, None),
        (True, 0.0, "cells turn right when the field turns left: the directions run clockwise"),
        (False, 0.6, "cells turn towards a direction that is +0.6"),
    ],
)
def test_the_side_of_a_field_file_is_tested_by_the_cells(tmp_path, clockwise, offset, says):
    steps = [(0.8 * k, 1.4 * k + 0.3 * (k % 3)) for k in range(12)]
    for name, off in (("field", 0.0), ("turned", offset)):
        rows = "".join(f"{t},{direction + off}\n" for t, direction in steps)
        (tmp_path / f"{name}.csv").write_text(f"time_s,direction_rad\n{rows}")
    paths = turned_by(read_field(tmp_path / "turned.csv"))
    said = describe_wrong_directions(read_field(tmp_path / "field.csv", clockwise), paths)
    assert len(said) == (says is not None)
    assert all(says in line for line in said)


STEPS = list(zip(0.8 * np.arange(12), np.random.default_rng(3).uniform(-3, 3, 12), strict=True))
"""Times [s] and directions [rad] of a field."""


def field_at_times(tmp_path, times):
    """The field of STEPS whose file states these times."""
    rows = "".join(f"{t},{direction}\n" for t, (_, direction) in zip(times, STEPS, strict=True))
    (tmp_path / "field.csv").write_text(f"time_s,direction_rad\n{rows}")
    return read_field(tmp_path / "field.csv")


@pytest.mark.parametrize(
    ("stated", "says"),
    [
        (
            lambda t: 30 * t,
            "fits the times of the directions only if the times are numbers of pictures",
        ),
        (
            lambda t: 1000 * t,
            "fits the times of the directions only if the times are milliseconds",
        ),
        (
            lambda t: 1e6 * t,
            "fits the times of the directions only if the times are microseconds",
        ),
        (
            lambda t: 1e9 * t,
            "fits the times of the directions only if the times are nanoseconds",
        ),
        (
            lambda t: t / 60,
            "fits the times of the directions only if the times are minutes",
        ),
        (lambda t: t + 1.2, "cells turn 1.2 s before the directions"),
        (lambda t: t - 1.5, "cells turn 1.5 s after the directions"),
    ],
)
def test_a_field_whose_times_are_not_the_tracks_is_refused(tmp_path, stated, says):
    def check(sent):
        readings = create_other_readings("field.csv", sent, 1 / 30, "cells")
        check_directions("field.csv", turned, sent, SHORT_DELAYS_S, readings)

    true_times = [time for time, _ in STEPS]
    true = field_at_times(tmp_path, true_times)
    turned = compute_courses(turned_by(true))
    check(true)
    wrong = field_at_times(tmp_path, [stated(time) for time in true_times])
    with pytest.raises(UsageError, match=rf"field\.csv: .*{says}"):
        check(wrong)


def test_cells_that_the_field_does_not_turn_say_nothing(tmp_path):
    (tmp_path / "field.csv").write_text("time_s,direction_rad\n0,0\n2,2\n4,1\n")
    field = read_field(tmp_path / "field.csv")
    assert describe_wrong_directions(field, turned_by(field, rates=(0.0, 0.0, 0.0))) == ()


def test_a_field_that_never_changes_shows_no_side(tmp_path):
    """Regression: rounding decided between two sides that explain the same."""
    (tmp_path / "field.csv").write_text("time_s,direction_rad\n0,1\n")
    field = read_field(tmp_path / "field.csv")
    for rates in ((1.0, 2.0, 2.5), (3.0, 4.0, 5.0), (3.3, 0.7, 5.1, 4.4)):
        turning = find_handedness(turned_by(field, rates), field.field_at)
        assert turning is not None and not turning.mirrored
