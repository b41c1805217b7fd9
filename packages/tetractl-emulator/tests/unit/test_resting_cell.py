"""Tests of the fault `rests`: one cell of an emulated dish stops swimming, and starts again."""

from types import SimpleNamespace

import numpy as np
from tetractl_emulator.pictures.field import _resting_switch

from tetractl.model.swimmers import Swimmers


def test_only_the_named_cell_rests_and_swims_on_afterwards():
    """Regression: a method that had another name, which only rehearsed days called."""
    cells = Swimmers.drawn(np.random.default_rng(620144), 2)
    dish = SimpleNamespace(cells=cells)
    bodies = [SimpleNamespace(name="first"), SimpleNamespace(name="second")]
    switch = _resting_switch(
        SimpleNamespace(cell="second"), SimpleNamespace(bodies=bodies, dish=dish)
    )
    switch(True)
    assert cells.resting.tolist() == [False, True]
    switch(False)
    assert cells.resting.tolist() == [False, False]
