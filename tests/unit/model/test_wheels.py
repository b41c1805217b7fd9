import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.core.clock import SECOND
from tetractl.model.wheels import LaggingTurns, body_velocity, wheel_speeds


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


def test_headings_ahead_are_those_in_which_lagging_robots_come_to_rest():
    """Turning rates sent at uneven times, followed with a lag, against an integration at 10 kHz."""
    rng, lag_s, step = np.random.default_rng(4), 0.04, 1e-4
    sent = {0.05: rng.normal(size=2), 0.08: rng.normal(size=2), 0.15: rng.normal(size=2)}
    turns = LaggingTurns(lag_s, 2)
    for when, rates in sent.items():
        turns.sent(round(when * SECOND), rates)
    heading, turning, wanted, headings = np.zeros(2), np.zeros(2), np.zeros(2), []
    for k in range(6000):
        wanted = sent.get(round(k * step, 4), wanted if k < 2000 else np.zeros(2))
        headings.append(heading)
        heading = heading + step * turning
        turning = turning + step / lag_s * (wanted - turning)
    for since in (0.02, 0.07, 0.12, 0.16):
        seen = headings[round(since / step)]
        found = turns.ahead(seen, round(since * SECOND), round(0.2 * SECOND))
        assert found == pytest.approx(headings[-1], abs=2e-3)
