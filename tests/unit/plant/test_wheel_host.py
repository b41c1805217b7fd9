"""Tests of the simulated host of robots on wheels: which speeds it sends, and when."""

from dataclasses import replace

import numpy as np
import pytest
from testkit.trials import experiment

from tetractl.core.clock import NEVER_NS, SECOND
from tetractl.core.commands import FieldOff, Steer, Turn
from tetractl.core.poses import Observation, Poses
from tetractl.model.wheels import COUNT_MAX, compute_body_velocity
from tetractl.plant.sim_section import WheelDriveSection
from tetractl.plant.wheel_host import SimHost, sample_drivetrains

RADIUS = 40.0
SETUP = experiment(wheels={"radius": RADIUS}).setup
ROBOTS = len(SETUP.names)
HEADINGS = np.array([0.0, 0.5, -2.0])


def host(seed=1, setup=SETUP, **section):
    return SimHost(WheelDriveSection(**section), setup, np.random.default_rng(seed))


def frame(headings=HEADINGS, sampled_ns=0):
    poses = Poses(np.zeros(ROBOTS), np.zeros(ROBOTS), np.array(headings))
    return Observation(1, sampled_ns, sampled_ns, poses, np.ones(ROBOTS, dtype=bool))


def motion(speeds):
    """Speeds and turning rates of robots with these wheel speeds."""
    return compute_body_velocity(speeds[0], speeds[1], RADIUS)


@pytest.mark.parametrize(
    ("action", "speed", "directions"),
    [
        (Steer(1.2), SETUP.speed, [1.2] * ROBOTS),
        (Turn(1.2), np.zeros(ROBOTS), [1.2] * ROBOTS),
        (FieldOff(), SETUP.speed, HEADINGS),
    ],
)
def test_robots_drive_and_turn_by_the_papers_equations_for_the_newest_headings(
    action, speed, directions
):
    known, true = host().transmit(5 * SECOND, action, True, frame())
    forward, turning = motion(known)
    assert forward == pytest.approx(speed)
    assert turning == pytest.approx(SETUP.a * np.sin(directions - HEADINGS))
    assert true == pytest.approx(known), "ideal wheels do what they are sent"


def test_a_held_action_is_answered_to_the_newest_headings_or_repeated_as_it_was():
    newer = frame(HEADINGS + 1.0)
    computing, repeating = host(), host(recompute=False)
    first = [each.transmit(0, Steer(1.2), True, frame())[0] for each in (computing, repeating)]
    again = [each.transmit(100, Steer(1.2), False, newer)[0] for each in (computing, repeating)]
    assert motion(again[0])[1] == pytest.approx(SETUP.a * np.sin(1.2 - HEADINGS - 1.0))
    assert again[1].tolist() == first[1].tolist()
    new = repeating.transmit(200, Steer(0.3), True, newer)[0]
    assert motion(new)[1] == pytest.approx(SETUP.a * np.sin(0.3 - HEADINGS - 1.0))


def test_the_headings_are_predicted_to_the_lead_after_the_sending_if_there_is_one():
    """Robots that turn at a low rate turn by nearly a sin(u - heading) times the time."""
    slow = replace(SETUP, a=np.full(ROBOTS, 0.01))
    sent_ns, lead_s, age_s = 3 * SECOND, 0.2, 0.3
    leading = host(setup=slow, lead=lead_s)
    known, _ = leading.transmit(sent_ns, Steer(1.2), True, frame(sampled_ns=sent_ns - 3 * 10**8))
    ahead = HEADINGS + (lead_s + age_s) * 0.01 * np.sin(1.2 - HEADINGS)
    assert motion(known)[1] == pytest.approx(0.01 * np.sin(1.2 - ahead), rel=1e-4)
    following = host(setup=slow)
    known, _ = following.transmit(sent_ns, Steer(1.2), True, frame(sampled_ns=sent_ns - 3 * 10**8))
    assert motion(known)[1] == pytest.approx(0.01 * np.sin(1.2 - HEADINGS), rel=1e-12)


def test_with_a_lag_robots_are_steered_for_the_headings_in_which_they_would_stand():
    lagging = replace(SETUP, lag_s=0.1)
    computing = host(setup=lagging, lead=0.05)
    first, _ = computing.transmit(0, Steer(1.2), True, frame())
    turning = motion(first)[1]
    assert turning == pytest.approx(SETUP.a * np.sin(1.2 - HEADINGS)), "they stood until now"
    # sent at 0, in effect at 0.05 s; what is sent at 0.1 s takes effect at 0.15 s
    second, _ = computing.transmit(SECOND // 10, Steer(1.2), True, frame(sampled_ns=0))
    at_rest = HEADINGS + 0.1 * turning
    assert motion(second)[1] == pytest.approx(SETUP.a * np.sin(1.2 - at_rest))


def test_a_lag_that_the_controller_found_is_used_from_that_command_on():
    at_first = replace(SETUP, lag_s=0.1)
    known, assumed = host(setup=at_first, lead=0.0), host(setup=at_first, lead=0.0)
    for computing, action in [(known, Steer(1.2)), (assumed, Steer(1.2, lag_s=0.4))]:
        computing.transmit(0, action, True, frame())
    rates = [
        motion(computing.transmit(SECOND // 5, Steer(1.2), True, frame(sampled_ns=SECOND // 10))[0])
        for computing in (known, assumed)
    ]
    assert not np.allclose(rates[0][1], rates[1][1])


def test_a_stop_is_known_when_the_next_headings_are_predicted():
    lagging = replace(SETUP, lag_s=0.1)
    driven, stopped = host(setup=lagging, lead=0.0), host(setup=lagging, lead=0.0)
    for computing in (driven, stopped):
        computing.transmit(0, Steer(1.2), True, frame())
    stopped.halt(SECOND // 10)
    seen = frame(sampled_ns=2 * SECOND)
    still, _ = stopped.transmit(2 * SECOND, Steer(1.2), True, seen)
    assert motion(still)[1] == pytest.approx(SETUP.a * np.sin(1.2 - HEADINGS), abs=1e-6)
    moving, _ = driven.transmit(2 * SECOND, Steer(1.2), True, seen)
    at_rest = HEADINGS + 0.1 * SETUP.a * np.sin(1.2 - HEADINGS)
    assert motion(moving)[1] == pytest.approx(SETUP.a * np.sin(1.2 - at_rest), abs=1e-6)


def test_a_host_without_a_rate_never_repeats_and_one_with_a_rate_does_until_a_stop():
    silent = host()
    silent.transmit(0, Steer(1.2), True, frame())
    assert silent.next_repeat_ns == NEVER_NS
    repeating = host(rate=50.0)
    assert repeating.next_repeat_ns == NEVER_NS
    repeating.transmit(SECOND, Steer(1.2), True, frame())
    assert repeating.next_repeat_ns == SECOND + SECOND // 100, "half a period at least"
    for k in range(3):
        repeating.transmit(repeating.next_repeat_ns, Steer(1.2), False, frame())
        assert repeating.next_repeat_ns == SECOND + SECOND // 100 + (k + 1) * SECOND // 50
    repeating.halt(2 * SECOND)
    assert repeating.next_repeat_ns == NEVER_NS


def test_wheels_without_errors_are_as_the_host_knows_them():
    trains = sample_drivetrains(
        WheelDriveSection(count=2.5, dead_zone=7), 4, np.random.default_rng(1)
    )
    assert trains.gain.tolist() == trains.true_gain.tolist() == [[2.5] * 4] * 2
    assert trains.dead_zone.tolist() == trains.true_dead_zone.tolist() == [[7] * 4] * 2
    assert trains.limit.tolist() == [COUNT_MAX] * 4
    assert not trains.rounding_errors.any()
    smooth = sample_drivetrains(WheelDriveSection(), 4, np.random.default_rng(1))
    assert smooth.limit.tolist() == [0] * 4
    assert smooth.gain.tolist() == smooth.true_gain.tolist() == [[1.0] * 4] * 2


def test_errors_of_wheels_are_uniform_within_their_bounds_and_dead_zones_not_negative():
    section = WheelDriveSection(count=2.0, gain_error=0.1, dead_zone=5, dead_zone_error=8)
    trains = sample_drivetrains(section, 4000, np.random.default_rng(1))
    factors = trains.true_gain / trains.gain
    assert factors.min() == pytest.approx(0.9, abs=0.001)
    assert factors.max() == pytest.approx(1.1, abs=0.001)
    assert factors.mean() == pytest.approx(1.0, abs=0.003)
    assert set(np.unique(trains.true_dead_zone)) == set(range(14))
    assert (trains.true_dead_zone > 0).mean() == pytest.approx(13 / 17, abs=0.02)
    assert (trains.gain == 2.0).all() and (trains.dead_zone == 5).all()


def test_a_robots_gain_is_the_mean_of_its_wheels():
    computing = host(gain_error=0.2)
    ratio = computing.drivetrains.true_gain / computing.drivetrains.gain
    assert computing.gains == pytest.approx((ratio[0] + ratio[1]) / 2)
    known, true = computing.transmit(0, FieldOff(), True, frame())
    assert motion(true)[0] / motion(known)[0] == pytest.approx(computing.gains)
