"""Tests that means over the cells of a table count cells, not the pieces of their tracks."""

import numpy as np
import pytest
from tetractl_microscope.tracks.cell_tables import cell_mean, known_values


def cell(number, since, seconds, speed, a=None, magnet=None):
    return {
        "cell": number, "since_s": since, "duration_s": seconds, "speed_um_s": speed,
        "a_rad_s": a, "magnetised": magnet,
    }  # fmt: skip


CELLS = [
    cell(1, 0.0, 8.0, 400.0, 4.0, True),
    cell(2, 0.0, 2.0, 300.0, 0.2, False),
    cell(3, 2.0, 6.0, 500.0, 5.0, True),  # the same cell as 2 under another number
    cell(4, 0.0, 8.0, 450.0, 4.0, True),
]


def test_a_cell_in_pieces_counts_once_and_by_its_time():
    mean = cell_mean(*known_values(CELLS, "speed_um_s"))
    assert mean.n == 3
    assert mean.mean == pytest.approx(np.average([400, 300, 500, 450], weights=[8, 2, 6, 8]))
    assert mean.ci95.low < mean.mean < mean.ci95.high
    assert cell_mean(CELLS[:1], [400.0]).n == 1 and not cell_mean(CELLS[:1], [400.0]).ci95.known
