"""Tests of recording the field in a dish as intervals of constant field."""

import math

import numpy as np
import pytest
from tetractl_microscope.cells.field_record import FieldSignals

from tetractl.core.clock import SECOND


def test_a_sent_field_acts_until_the_next_in_axes_of_the_picture():
    sent = FieldSignals()
    assert sent.record(0.3).pieces(0.0, 0.5) == [(0.5, 0.0, 0.0)]
    for seconds, direction in ((1.0, 0.0), (1.5, 0.0), (2.0, math.pi / 2), (3.0, None)):
        sent.note(direction, round(seconds * SECOND))
    pieces = sent.record(math.pi / 2).pieces(0.5, 3.5)
    expected = [(0.5, 0, 0), (1.0, 0, -1), (1.0, 1, 0), (0.5, 0, 0)]
    assert np.array(pieces) == pytest.approx(np.array(expected), abs=1e-9)
