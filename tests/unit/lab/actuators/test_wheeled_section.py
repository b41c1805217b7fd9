"""Tests of writing the results of a calibration to the fields of a section."""

from dataclasses import replace

import pytest

from tetractl.core.errors import AbortError
from tetractl.lab.actuators.wheeled_section import Found, FoundWheel, SpeedSection, wheel_gains

LEFT = FoundWheel(gain_mm=1.8, dead_zone=0, invert=False)
RIGHT = FoundWheel(gain_mm=2.2, dead_zone=0, invert=False)
ROBOT = Found(heading_offset=0.1, radius_mm=44.0, left=LEFT, right=RIGHT, swap=False)


def test_gains_are_of_the_nominal_speed():
    gains = wheel_gains(ROBOT, 2.0)
    assert gains == {"radius_mm": 44.0, "left_gain": 1.8 / 2.0, "right_gain": 2.2 / 2.0}


@pytest.mark.parametrize(
    "robot",
    [
        replace(ROBOT, left=LEFT._replace(invert=True)),
        replace(ROBOT, right=RIGHT._replace(invert=True)),
        replace(ROBOT, swap=True),
    ],
    ids=["left", "right", "swap"],
)
def test_wheels_that_a_section_cannot_state_are_refused(robot):
    with pytest.raises(AbortError, match="a wheel turns backwards, or the two wheels are swapped"):
        wheel_gains(robot, 2.0)


class InTenths(SpeedSection):
    """A section of robots whose wheels receive tenths of mm/s."""

    unit_mm = 0.1


@pytest.mark.parametrize(("section", "unit_mm"), [(SpeedSection, 1.0), (InTenths, 0.1)])
@pytest.mark.parametrize("limit", [1, 64, 127])
def test_outputs_of_a_calibration_are_parts_of_the_maximum_speed(section, unit_mm, limit):
    unit, most = section.model_construct(speed_max_mm_s=381.0).outputs("green", limit)
    assert 127 * unit * unit_mm == pytest.approx(381.0)
    assert most * unit_mm == pytest.approx(3.0 * limit, abs=unit_mm)
    assert most * unit_mm <= 3.0 * limit + 1e-9
