"""What calibration found, as the fields of a section."""

from dataclasses import replace

import pytest

from tetractl.core.errors import AbortError
from tetractl.lab.actuators.wheeled_section import Found, FoundWheel, wheel_gains

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
    with pytest.raises(AbortError, match="a wheel turns the wrong way, or the wheels are swapped"):
        wheel_gains(robot, 2.0)
