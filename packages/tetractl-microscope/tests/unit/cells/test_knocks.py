"""The shift between two pictures."""

import numpy as np
import pytest
from tetractl_microscope.cells.knocks import shift_of

pytestmark = pytest.mark.slow


SPECK_PX = 13  # beyond this distance from its middle, a speck darkens nothing


@pytest.mark.parametrize("by", [(12, 7), (40, -200), (-280, 90)])
def test_a_far_knock_is_seen_under_uneven_light(by) -> None:
    """Regression: light moved with the debris hid a knock by a fifth of the picture."""
    random = np.random.default_rng(5)
    side = 1024
    rows, columns = np.mgrid[:side, :side].astype(np.float32)
    light = 160 * (1 - 0.2 * np.hypot(rows - side / 2, columns - side / 2) / side * 1.41)
    specks = random.uniform(-200, side + 200, (30, 2))

    def picture(right, down):
        dark = np.zeros((side, side), np.float32)
        for x, y in specks:
            column = max(0, int(x + right) - SPECK_PX)
            row = max(0, int(y + down) - SPECK_PX)
            near = np.s_[row : row + 2 * SPECK_PX + 1, column : column + 2 * SPECK_PX + 1]
            far = np.hypot(columns[near] - x - right, rows[near] - y - down) / 6
            dark[near] += 50 * np.clip(2 - far, 0, 1)
        return np.clip(light - dark + random.normal(0, 3, light.shape), 0, 255).astype(np.uint8)

    shift = shift_of(picture(0, 0), picture(*by))
    assert shift == pytest.approx(by, abs=2)
    assert shift_of(picture(0, 0), picture(0, 0)) == (0.0, 0.0)
