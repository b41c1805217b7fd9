"""Tests of when driving on counts as gaining nothing."""

import pytest

from tetractl.control.methods.gain import FAILED_MAX, NOTHING_YET, WINDOW_MIN_S, Follows

PLAN_S = 8.0
STRAYS = Follows(fits=False, is_far_off=True)


def gain_after(*errors, follows=STRAYS, promised=0.0):
    """Return the gain after windows, in each of which robots drive and reach an error [mm]."""
    gain = NOTHING_YET.begun(0.0, PLAN_S)
    for number, least in enumerate(errors):
        for part, error in ((0.1, 1000.0), (0.5, least), (1.0, 1000.0)):
            gain = gain.after((number + part) * PLAN_S, error, False, promised, follows)
    return gain


def test_robots_that_come_nearer_go_on():
    assert not gain_after(800, 300, 100, 40, 15).is_over


def test_robots_that_come_no_nearer_end_after_some_windows():
    failing = [300] * FAILED_MAX
    assert not gain_after(300, *failing[1:]).is_over
    assert gain_after(300, *failing).is_over


@pytest.mark.parametrize(
    "follows",
    [Follows(fits=True, is_far_off=True), Follows(fits=False, is_far_off=False)],
)
def test_robots_that_follow_the_model_go_on(follows):
    """Lost commands or stuck robots can spoil any number of plans."""
    assert not gain_after(*[300] * 10, follows=follows).is_over


def test_a_misfit_in_the_first_window_does_not_count():
    """The filters still learn."""
    gain = NOTHING_YET.begun(0.0, PLAN_S)
    for k in range(100):
        follows = Follows(fits=k * 1.0 > PLAN_S, is_far_off=True)
        gain = gain.after(k * 1.0, 300.0, False, 0.0, follows)
    assert not gain.is_over


def test_what_plans_do_not_promise_is_not_missed():
    assert not gain_after(*[300] * 10, promised=300.0).is_over


def test_a_window_that_gains_starts_the_count_again():
    assert not gain_after(800, 790, 200, 190).is_over


def test_it_stays_over():
    assert gain_after(300, *[300] * FAILED_MAX, 1, 1).is_over


@pytest.mark.parametrize("rests", [True, False])
def test_only_errors_at_rest_count_if_there_are_some(rests):
    """Regression: robots that rolled on after each stop passed their targets again and again."""
    gain = NOTHING_YET.begun(0.0, PLAN_S)
    passed = 400.0
    for k in range(1, 41):
        stands = rests and k % 8 == 7
        passed = max(1.0, passed / 1.2)
        gain = gain.after(float(k), 100.0 if stands else passed, stands, 0.0, STRAYS)
    assert gain.is_over == rests


def test_passing_the_targets_is_no_gain_once_robots_have_stood_still():
    gain = NOTHING_YET.begun(0.0, PLAN_S)
    for k in range(1, 41):
        stands = k == 20
        gain = gain.after(float(k), 70.0 if stands else 30.0, stands, 0.0, STRAYS)
    assert gain.is_over
    assert "to rest nearer than 70 mm" in gain.describe("mm")


def test_a_window_is_not_shorter_than_a_detour():
    assert NOTHING_YET.begun(3.0, 0.5).ends_s == 3.0 + WINDOW_MIN_S


def test_the_description_tells_time_and_error():
    text = gain_after(300, *[290] * FAILED_MAX).describe("mm")
    assert f"for {FAILED_MAX * PLAN_S:.0f} s" in text
    assert "nearer than 290 mm" in text
