"""What the signal can reach, by `analyze` and `validate`, against the plant."""

import numpy as np
import pytest
from steerable import drawn, judged, right, setup_of

from tetractl.analysis.reach import reach_of

pytestmark = pytest.mark.slow


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_verdicts_agree_with_the_plant(seed):
    setup, motion = drawn(np.random.default_rng(seed), near=bool(seed % 2))
    assert right(setup, motion, reach_of(setup, "exact"), judged(setup, motion, seed), seed)[0]


def test_a_wrong_verdict_is_seen():
    alike = setup_of(np.array([4.0, 4.0]), np.array([100.0, 50.0]), np.zeros(2))
    unlike = setup_of(np.array([4.0, 5.0]), np.array([100.0, 50.0]), np.zeros(2))
    verdict = judged(alike, "exact", 1)
    assert right(alike, "exact", reach_of(alike, "exact"), verdict, 1)[0]
    assert not right(unlike, "exact", reach_of(unlike, "exact"), verdict, 1)[0]
