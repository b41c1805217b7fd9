"""What calibration found, as the fields of a section."""

import pytest

from tetractl.core.errors import AbortError
from tetractl.lab.actuators.wheeled_section import Found, FoundWheel


def found(left=False, right=False, swap=False):
    return Found(0.1, 44.0, FoundWheel(1.8, 0, left), FoundWheel(2.2, 0, right), swap)


def test_gains_are_of_the_nominal_speed():
    assert found().gains(2.0) == {"radius_mm": 44.0, "left_gain": 0.9, "right_gain": 1.1}


@pytest.mark.parametrize("wrong", ["left", "right", "swap"])
def test_wheels_that_a_section_cannot_state_are_refused(wrong):
    with pytest.raises(AbortError, match="a wheel turns the wrong way, or the wheels are swapped"):
        found(**{wrong: True}).gains(2.0)
