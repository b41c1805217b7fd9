"""Tests of what the section for a user's own robots refuses."""

from dataclasses import replace

import numpy as np
import pytest
from testkit.trials import experiment

from tetractl.lab.actuators.own_section import OwnSection

NAMES = ("green", "blue", "red")
SETUP = replace(experiment().setup, names=NAMES, wheel_radius=40.0, metres=0.001, watchdog_s=0.25)


class OwnRobotsSection(OwnSection):
    type: str = "own"


def section(speed_max_mm_s):
    robots = [
        {"name": name, "address": f"udp://127.0.0.1:{9801 + i}"} for i, name in enumerate(NAMES)
    ]
    return OwnRobotsSection.model_validate({"robots": robots, "speed_max_mm_s": speed_max_mm_s})


@pytest.mark.parametrize(
    ("speed_mm_s", "problems"),
    [
        (400.0, []),
        (600.0, [(("speed_max_mm_s",), "is below the speed of blue, which is 600 mm/s")]),
    ],
)
def test_a_robot_that_is_faster_than_its_wheels_are_driven_is_refused(speed_mm_s, problems):
    """Regression: its wheels were driven at `speed_max_mm_s`, and nothing said so, while the
    controller planned with its speed."""
    setup = replace(SETUP, speed=np.array([100.0, speed_mm_s, 100.0]))
    assert list(section(400.0).contradictions(setup)) == problems
