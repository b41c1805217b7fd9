"""Which exposure a logged picture shows, as far as an observer can tell."""

import numpy as np
from tetractl_emulator.rehearsal.truth import TimeSpan, nearest_exposures

EXPOSED_S = np.array([7.800, 7.833, 7.867, 7.900, 7.933])


def test_a_picture_that_waited_while_the_program_was_suspended_shows_no_certain_exposure():
    # taken at 7.905, when the program went on, minus a latency of 50 ms: nearest to an exposure at
    # which the robot was hidden already, but waiting since before
    stamps_s = np.array([7.270, 7.801, 7.855, 7.934])
    rows = nearest_exposures(stamps_s, EXPOSED_S, [TimeSpan(7.284, 7.905)])
    assert rows == [None, None, None, 4]
    assert nearest_exposures(stamps_s, EXPOSED_S, []) == [None, 0, 2, 4]
