"""Tests of robots on wheels in a simulation, against formulas."""

import json
import math

import numpy as np
import pytest
from testkit.plants import driven, sim, truths
from testkit.trials import experiment

from tetractl.core.clock import SECOND
from tetractl.core.commands import Steer
from tetractl.model.motion.exact import step as exact
from tetractl.model.wheels import compute_body_velocity
from tetractl.spec.plant import Wheels

pytestmark = pytest.mark.slow

COUNT = 1000 / 127  # speed of a wheel per count [mm/s]
ROBOTS = experiment().robots


def plant(seed=1, drive=None, lag=0.0, **fields):
    wheels = {"radius": 40, "lag": lag}
    spec = experiment(plant={"drive": drive or {}, **fields}, wheels=wheels, obstacles=[])
    return sim(spec, seed)


def test_ideal_wheels_at_a_high_rate_follow_1_to_3():
    fast = plant(drive={"rate": 1000}, camera_rate=1000, truth_rate=1000)
    _, samples = driven(fast)
    spec = experiment(plant={}, obstacles=[])
    _, exact = driven(sim(spec, 1))
    assert truths(samples)[-1] == pytest.approx(truths(exact)[-1], abs=2.0)


@pytest.mark.parametrize("lag", [0.0, 0.1])
def test_what_is_sent_is_computed_from_the_newest_frame_received(lag):
    fields = {
        "disturbances": [{"type": "camera-latency", "mean": 0.03}],
        "measurement_noise": {"heading": 0.05},
    }
    simulated = plant(drive={"rate": 40}, lag=lag, **fields)
    commands, samples = driven(simulated)
    received = np.array([sample.observation.received_ns for sample in samples])
    a = np.array([robot.a for robot in experiment().robots])
    for command in commands[5:]:
        newest = samples[int(np.searchsorted(received, command.sent_ns, side="right")) - 1]
        _, turning = compute_body_velocity(command.left, command.right, 40)
        measured = newest.observation.poses.heading
        assert turning == pytest.approx(a * np.sin(command.direction - measured), abs=1e-9)


def test_counts_are_whole_and_their_mean_is_what_was_wished():
    commands, _ = driven(plant(drive={"rate": 40, "count": COUNT}), [0.0] * 40)
    left_mm_s = np.array([command.left for command in commands])
    counts = left_mm_s / COUNT
    assert counts == pytest.approx(np.round(counts), abs=1e-9)
    assert left_mm_s.mean(axis=0) == pytest.approx([180, 200, 150], abs=COUNT / 4)


@pytest.mark.parametrize("part", ["gain_error", "radius_error"])
def test_gains_and_radii_err_within_their_bounds_and_are_not_what_is_logged(part):
    turned = []
    for seed in range(40):
        simulated = plant(seed, {part: 0.1})
        commands, samples = driven(simulated, [math.pi / 2])
        _, sent = compute_body_velocity(commands[0].left, commands[0].right, 40)
        path = truths(samples)
        rate = (path[-1] - path[0])[:, 2] / (len(path) - 1) * 120
        turned.append(rate / sent)
        if part == "radius_error":
            assert sent == pytest.approx([6, 4, 3])
    ratio = np.array(turned)
    assert ratio.std() > 0.01
    assert np.abs(ratio - 1).max() < (0.12 if part == "radius_error" else 0.6)


def test_a_and_speed_that_a_log_calls_true_are_those_of_the_robot():
    drive = {"gain_error": 0.2, "radius_error": 0.2}
    facts = plant(drive=drive).open().facts
    _, samples = driven(plant(drive=drive, truth_rate=120), [0.0])  # straight on from heading 0
    path = truths(samples)
    mm_s = np.hypot(*(path[1] - path[0])[:, :2].T) * 120
    assert json.loads(facts["true_speed"]) == pytest.approx(mm_s, rel=1e-3)
    aside = [turn_of_the_first_frame(drive, u) for u in (math.pi / 2, -math.pi / 2)]
    rad_s = (aside[0] - aside[1]) / 2 * 120  # without the turn by wheels that differ
    assert json.loads(facts["true_a"]) == pytest.approx(rad_s, rel=0.01)
    assert json.loads(facts["true_a"]) != pytest.approx([6, 4, 3], rel=0.01)


def turn_of_the_first_frame(drive, u):
    path = truths(driven(plant(drive=drive, truth_rate=120), [u])[1])
    return (path[1] - path[0])[:, 2]


def test_dead_zones_that_the_host_does_not_know_turn_robots():
    simulated_plant = plant(drive={"count": COUNT, "dead_zone": 6})
    wrong = plant(drive={"count": COUNT, "dead_zone": 6, "dead_zone_error": 2})
    straight = truths(driven(simulated_plant, [0.0] * 5)[1])[-1]
    bent = truths(driven(wrong, [0.0] * 5)[1])[-1]
    assert straight[:, 2] == pytest.approx(0, abs=1e-9)
    assert np.abs(bent[:, 2]).max() > 0.05


def test_a_host_that_knows_the_lag_turns_robots_as_if_there_were_none():
    """The headings in which the robots come to rest fall to the direction by (3), however they
    turned before.
    """
    drive = {"rate": 400, "lead": 0.0, "lag": 0.04}
    spec = experiment(plant={"drive": drive, "camera_rate": 960}, obstacles=[])
    errors = {}
    for lag in (0.0, 0.04):
        simulated = sim(spec.model_copy(update={"wheels": Wheels(radius=40, lag=lag)}))
        simulated.open()
        simulated.send(Steer(1.0))
        simulated.clock.sleep_until(SECOND // 10)
        simulated.send(Steer(-0.5))
        simulated.clock.sleep_until(SECOND // 5)
        simulated.observe()
        simulated.stop()
        setup = simulated.setup
        heading = simulated.settle().final.heading
        expected = np.zeros(3)
        for u in (1.0, -0.5):
            nowhere = np.zeros(3)
            _, _, expected = exact(nowhere, nowhere, expected, u, setup.a, setup.speed, 0.1)
        errors[lag] = np.abs(heading - expected).max()
    assert errors[0.04] < 1e-3
    assert errors[0.0] > 4e-3
