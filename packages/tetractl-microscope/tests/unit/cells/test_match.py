"""What a place in a blob costs a cell that may share it."""

from types import SimpleNamespace

import numpy as np
import pytest
from tetractl_microscope.cells.match import NONE, SHARED, SHARED_LARGE, _shared_costs

CELL_UM2 = 100.0


@pytest.mark.parametrize(
    ("times_as_large", "missed_s", "cost"),
    [(2.0, 0.0, SHARED_LARGE), (1.0, 0.0, SHARED), (2.0, 0.1, SHARED_LARGE), (1.0, 0.1, NONE)],
)
def test_a_blob_too_large_for_one_cell_is_shared_at_less_cost(times_as_large, missed_s, cost):
    """One of the size of a cell, by none that was not seen before."""
    size = SimpleNamespace(wide=5.0, area_um2=CELL_UM2)
    cell = SimpleNamespace(size=size, missed_s=missed_s)
    pixels = np.array([[50.0, 50.0]])
    blob = SimpleNamespace(x=50.0, y=50.0, long=20.0, wide=5.0 * times_as_large, pixels=pixels)
    assert _shared_costs([cell], pixels, [blob], um_px=1.0).tolist() == [[cost]]
