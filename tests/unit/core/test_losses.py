"""Tests of which robots are lost or dead, from frames at the limits of the rules."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.core.clock import SECOND
from tetractl.core.losses import (
    DEAD_AFTER_S,
    STRIDE_MIN_S,
    LossRule,
    LossTracker,
    StandstillDetector,
    describe_dead,
)
from tetractl.core.poses import Observation, Poses

LOOK_NS = SECOND // 10


def frame(time_ns, valid, xy=None):
    """A frame of robots at these places, by default far apart and at rest."""
    count = len(valid)
    places = np.zeros((count, 2)) if xy is None else np.asarray(xy, dtype=float)
    rows = np.column_stack([places, np.zeros(count)])
    return Observation(0, time_ns, time_ns, Poses.from_array(rows), np.array(valid, dtype=bool))


def after(rule, frames, count=2):
    """The losses after some frames, and the robots that were replaced in each."""
    losses = LossTracker(rule, np.ones(count))
    replaced = [losses.add_frame(one) for one in frames]
    return losses, replaced


GONE_S = 0.3
RULE = LossRule(GONE_S, replaces_lost=False)
MS = SECOND // 1000


def seen_until(*changes_ms, end_ms):
    """Frames every 50 ms. The second robot is seen until the first change, then not, and so on."""
    times = sorted({*range(0, end_ms, 50), *changes_ms, end_ms})
    return [frame(t * MS, [1, sum(t > change for change in changes_ms) % 2 == 0]) for t in times]


@pytest.mark.parametrize(("gone_ms", "is_lost"), [(299, False), (300, True), (500, True)])
def test_a_robot_is_lost_once_it_was_untracked_for_the_time_of_the_rule(gone_ms, is_lost):
    losses, _ = after(RULE, seen_until(50, end_ms=50 + gone_ms))
    assert losses.lost.tolist() == [False, is_lost]
    assert losses.present.tolist() == [True, not is_lost]
    assert losses.loss_counts.tolist() == [0, int(is_lost)]
    assert losses.change_count == int(is_lost)


def test_the_time_counts_from_the_last_frame_that_showed_the_robot():
    seen = [frame(t * MS, [1, t % 200 == 0]) for t in range(0, 2000, 20)]
    losses, _ = after(RULE, seen)
    assert not losses.lost.any()
    losses, _ = after(LossRule(0.1, False), seen)
    assert losses.lost.tolist() == [False, True]


@pytest.mark.parametrize(("end_ms", "is_lost"), [(299, False), (300, True)])
def test_a_robot_that_was_never_seen_is_lost_after_the_time_from_the_first_frame(end_ms, is_lost):
    begin = 7 * SECOND
    times = [*range(0, end_ms, 50), end_ms]
    losses, _ = after(RULE, [frame(begin + t * MS, [1, 0]) for t in times])
    assert losses.lost.tolist() == [False, is_lost]


def test_a_robot_that_is_seen_too_rarely_is_lost():
    """Even if it is seen in the frame that ends the gap."""
    losses, _ = after(RULE, [frame(0, [1, 1]), frame(300 * MS, [1, 1])])
    assert losses.lost.tolist() == [True, True]
    losses, _ = after(RULE, [frame(0, [1, 1]), frame(299 * MS, [1, 1])])
    assert losses.lost.tolist() == [False, False]


AWAY = seen_until(0, end_ms=400)
BACK = frame(450 * MS, [1, 1])


def test_a_lost_robot_stays_lost_unless_the_rule_replaces_it():
    losses, replaced = after(RULE, [*AWAY, BACK])
    assert losses.lost.tolist() == [False, True]
    assert not any(replaced)


def test_a_robot_that_is_tracked_again_was_replaced_once_and_can_be_lost_again():
    losses, replaced = after(LossRule(GONE_S, True), seen_until(0, 400, 600, end_ms=1000))
    assert [back for back in replaced if back] == [[1]]
    assert losses.lost.tolist() == [False, True]
    assert losses.loss_counts.tolist() == [0, 2]
    assert losses.change_count == 3


@pytest.mark.parametrize("rule", [None, LossRule(GONE_S, False, ends_trial=True)])
def test_no_robot_is_lost_without_a_rule_or_if_a_loss_ends_the_trial(rule):
    losses, replaced = after(rule, [*AWAY, BACK])
    assert not losses.lost.any()
    assert not any(replaced)


@given(st.integers(0, 10_000), st.booleans())
def test_losses_are_those_of_a_rule_applied_frame_by_frame(seed, replaced):
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.integers(5, 120, 40)) * MS
    valid = rng.random((40, 3)) < rng.uniform(0.2, 0.9)
    losses = LossTracker(LossRule(GONE_S, replaced), np.ones(3))
    tracked, lost = [int(times[0])] * 3, [False] * 3
    for time_ns, seen in zip(times.tolist(), valid.tolist(), strict=True):
        back = []
        for robot in range(3):
            if time_ns - tracked[robot] >= GONE_S * SECOND:
                lost[robot] = True
            if seen[robot]:
                tracked[robot] = time_ns
                if lost[robot] and replaced:
                    lost[robot] = False
                    back.append(robot)
        assert losses.add_frame(frame(time_ns, seen)) == back
        assert losses.lost.tolist() == lost


# robots that stand while others drive


def driving(speeds, true_speeds, seconds, valid=None, until_s=None):
    """Frames ten times a second of robots that drive along x at their true speeds [1/s]."""
    standing = StandstillDetector(np.array(speeds, dtype=float))
    dead = np.zeros(len(speeds), dtype=bool)
    for k in range(round(seconds * 10) + 1):
        time_s = k / 10
        moved_s = time_s if until_s is None else min(time_s, until_s)
        xy = [[speed * moved_s, 0.0] for speed in true_speeds]
        found = standing.add_frame(frame(k * LOOK_NS, valid or [True] * len(speeds), xy))
        if found is not None:
            dead = dead | found
    return dead.tolist()


@pytest.mark.parametrize(
    ("seconds", "is_dead"), [(DEAD_AFTER_S - 0.2, False), (DEAD_AFTER_S + 0.2, True)]
)
def test_a_robot_that_stands_while_another_drives_for_five_seconds_is_dead(seconds, is_dead):
    assert driving([10, 10], [10, 0], seconds) == [False, is_dead]
    assert driving([10, 10], [0, 10], seconds) == [is_dead, False]


def test_no_robot_is_dead_while_all_stand_or_all_drive():
    assert driving([10, 10], [0, 0], 20) == [False, False]
    assert driving([10, 10], [10, 10], 20) == [False, False]
    assert driving([10, 10], [10, 0], 20, until_s=4.0) == [False, False]


def test_the_time_of_driving_is_that_at_each_robots_own_speed():
    """The first robot is fast: it drives as long as it takes at its speed, not as far."""
    assert driving([100, 10], [100, 0], DEAD_AFTER_S - 0.2) == [False, False]
    assert driving([100, 10], [50, 0], 2 * DEAD_AFTER_S - 0.4) == [False, False]
    assert driving([100, 10], [50, 0], 2 * DEAD_AFTER_S + 0.4) == [False, True]


def test_a_slow_robot_that_moves_is_not_dead():
    slowly = 10 * STRIDE_MIN_S / DEAD_AFTER_S * 1.5
    assert driving([10, 10], [10, slowly], 20) == [False, False]


def test_a_robot_of_speed_0_is_never_dead():
    assert driving([10, 0], [10, 0], 20) == [False, False]


def test_a_robot_that_is_not_seen_is_not_dead():
    assert driving([10, 10], [10, 0], 20, valid=[True, False]) == [False, False]


def test_a_jump_is_no_long_drive():
    standing = StandstillDetector(np.array([10.0, 10.0]))
    for k in range(12):
        xy = [[1e6 * k, 0], [0, 0]]
        found = standing.add_frame(frame(k * LOOK_NS, [True, True], xy))
        assert found is None or not found.any()


def test_frames_between_two_checks_are_skipped():
    standing = StandstillDetector(np.array([10.0]))
    standing.add_frame(frame(0, [True]))
    assert standing.due_ns == LOOK_NS
    standing.add_frame(frame(LOOK_NS + 1, [True]))
    assert standing.due_ns == 2 * LOOK_NS
    assert standing.add_frame(frame(3 * LOOK_NS, [True])) is None  # nothing moved
    assert standing.due_ns == 4 * LOOK_NS


def drive_into_death(rule):
    losses = LossTracker(rule, np.array([10.0, 10.0]))
    for k in range(70):
        losses.add_frame(frame(k * LOOK_NS, [1, 1], [[k, 0], [0, 0]]))
    return losses


@pytest.mark.parametrize(
    ("rule", "is_lost"),
    [
        (LossRule(GONE_S, False, includes_dead=True), True),
        (LossRule(GONE_S, False, includes_dead=False), False),
        (LossRule(GONE_S, False, includes_dead=True, ends_trial=True), False),
        (None, False),
    ],
)
def test_a_dead_robot_is_lost_only_if_the_rule_says_so(rule, is_lost):
    losses = drive_into_death(rule)
    assert losses.dead.tolist() == [False, True]
    assert losses.lost.tolist() == [False, is_lost]
    assert losses.loss_counts.tolist() == [0, int(is_lost)]
    assert losses.change_count == int(is_lost)


def test_dead_robots_are_named():
    names = ("A", "B", "C")
    assert describe_dead(names, np.array([False, True, False])) == (
        "B does not move while others drive"
    )
    assert describe_dead(names, np.array([True, True, False])) == (
        "A, B do not move while others drive"
    )
    assert describe_dead(names, np.zeros(3, dtype=bool)) == ""
