"""Tests that the time of a trial begins with its first command."""

import numpy as np
import pytest

from tetractl.control.methods.trial_time import TrialTime
from tetractl.core.commands import Command, Steer
from tetractl.core.poses import Observation, Poses

POSES = Poses.from_array(np.zeros((1, 3)))


def seen(seconds):
    ns = round(seconds * 1e9)
    return Observation(0, ns, ns, POSES, np.ones(1, dtype=np.bool_))


def sent(seconds):
    return Command(Steer(0.0), round(seconds * 1e9), (True,))


@pytest.mark.parametrize("latency_s", [0.0, 0.04, 1.0])
def test_a_trial_of_two_seconds_has_ten_periods_after_its_first_command(latency_s):
    """However old its frames are."""
    time = TrialTime(2.0, 0.2)
    time.add_step(seen(1.0), None)  # the first plan takes 4 s
    steps = 0
    while not time.is_over:
        steps += 1
        time.add_step(seen(5.0 + 0.2 * steps - latency_s), sent(4.8 + 0.2 * steps))
        assert int(time.periods_left) == 10 - steps
    assert steps == 10


def test_after_a_rest_of_three_and_a_half_periods_each_step_takes_one_of_those_left():
    """Regression: the time left was then a whole number of periods, which rounding made one less in
    some steps; so a plan that fitted lost its next signal.

    The rest begins with the first command and ends at 0.7 s. Of 20 s, 96.5 periods are left then.
    """
    time = TrialTime(20.0, 0.2)
    time.add_step(seen(0.0), None)
    periods_left = []
    for step in range(97):
        end_of_rest_s = 0.7
        last_sent_s = end_of_rest_s - 0.2 + 0.2 * step if step else 0.0
        time.add_step(seen(end_of_rest_s + 0.2 * step), sent(last_sent_s))
        periods_left.append(int(time.periods_left))
    assert periods_left == list(range(97, 0, -1))
