"""Frames encoded in a message that is there already: the bytes of a new one."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tetractl.core.poses import Observation, Poses
from tetractl.log.format import tetractl_pb2 as pb
from tetractl.log.format.codec import encode_observation, encode_truth

NUMBERS = st.sampled_from([0.0, -0.0, 1.5, -2e300, math.nan, math.inf])


@st.composite
def frames(draw):
    robots = draw(st.integers(1, 4))
    times = [draw(st.integers(0, 2**40)) for _ in range(3)]
    rows = [np.array([draw(NUMBERS) for _ in range(robots)]) for _ in range(3)]
    valid = np.array([draw(st.booleans()) for _ in range(robots)])
    return Observation(*times, Poses(*rows), valid)


@given(st.lists(frames(), min_size=2, max_size=4))
def test_nothing_is_left_of_the_frame_before(seen):
    mocap, truth = pb.MocapSample(), pb.Truth()
    for one in seen:
        anew = encode_observation(one).SerializeToString()
        assert encode_observation(one, mocap).SerializeToString() == anew
        anew = encode_truth(one, one.poses).SerializeToString()
        assert encode_truth(one, one.poses, truth).SerializeToString() == anew
