"""The shift between two pictures."""

import numpy as np
import pytest
from tetractl_microscope.cells.knocks import shift_of

pytestmark = pytest.mark.slow


def test_a_picture_far_wider_than_high_has_no_shift() -> None:
    wide = np.full((32, 65_666), 90, np.uint8)
    assert shift_of(wide, wide) == (0.0, 0.0)
