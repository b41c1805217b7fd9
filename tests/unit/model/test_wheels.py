import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.model.wheels import body_velocity, wheel_speeds


def test_the_papers_robot_by_hand():
    left, right = wheel_speeds(np.array([0.0]), math.pi / 2, np.array([6.0]), np.array([180.0]), 40)
    assert (left[0], right[0]) == (180 - 240, 180 + 240)  # (24), (25)
    assert body_velocity(left, right, 40) == (180, 6)  # (21)-(23)


@given(
    heading=st.floats(-10, 10),
    u=st.floats(-10, 10),
    a=st.floats(0.1, 20),
    v=st.floats(0, 500),
    r=st.floats(1, 100),
)
def test_the_wheels_turn_a_robot_like_a_cell(heading, u, a, v, r):
    left, right = wheel_speeds(np.array([heading]), u, np.array([a]), np.array([v]), r)
    speed, turning = body_velocity(left, right, r)
    assert speed[0] == pytest.approx(v, abs=1e-9)
    assert turning[0] == pytest.approx(a * math.sin(u - heading), abs=1e-9)  # (3)
