"""A cell in one picture is where its blob is."""

import math
from dataclasses import replace

import numpy as np
import pytest
from support.film_rows import seen_cell

NAN = math.nan


@pytest.mark.parametrize(
    ("place", "blob", "expected"),
    [
        ((110.0, 52.0), (100.0, 50.0, 0.0, 40.0, 20.0), (110.0, 52.0)),  # on it
        ((160.0, 50.0), (100.0, 50.0, 0.0, 40.0, 20.0), (120.0, 50.0)),  # beyond its end
        ((100.0, 90.0), (100.0, 50.0, 0.0, 40.0, 20.0), (100.0, 60.0)),  # next to it
        ((100.0, 90.0), (100.0, 50.0, math.pi / 2, 40.0, 20.0), (100.0, 70.0)),  # it is upright
        ((-60.0, 50.0), (3.0, 50.0, 0.0, NAN, NAN), (3.0, 50.0)),  # the picture's edge cuts it off
    ],
)
def test_a_place_beyond_its_blob_is_moved_to_the_blobs_edge(place, blob, expected):
    cell = replace(seen_cell(1, *place, track=1), blob_um=np.array(blob))
    on_blob = cell.on_blob()
    assert (on_blob.x, on_blob.y) == pytest.approx(expected, abs=1e-4)
