import json
import math

import numpy as np
import pytest
import scipy
from scipy.integrate import solve_ivp
from testkit.plants import DIRECTIONS, PERIOD, driven, sim, truths
from testkit.trials import experiment

from tetractl.control.search.cost import predict
from tetractl.core.clock import SECOND
from tetractl.core.commands import Steer
from tetractl.core.poses import Poses
from tetractl.model.motion.exact import step as exact
from tetractl.model.wheels import compute_body_velocity

pytestmark = pytest.mark.slow

STRAIGHT = [  # a robot that hardly turns, along +x at 100 mm/s
    {"name": "arrow", "start": [900, 800], "target": [1700, 500], "a": 1e-9, "speed": 100}
]


def plant(robots=None, obstacles=(), seed=1, wheels=None, **fields):
    changes = {} if robots is None else {"robots": robots}
    spec = experiment(plant=fields, obstacles=list(obstacles), wheels=wheels, **changes)
    return sim(spec, seed)


def steered(simulated, directions):
    """Every sample of robots that are steered."""
    return driven(simulated, directions)[1]


def measured(samples):
    return np.array([sample.observation.poses.array() for sample in samples])


def test_the_continuous_plant_solves_1_to_3():
    simulated = plant()
    path = truths(steered(simulated, DIRECTIONS))
    for i, robot in enumerate(experiment().robots):
        state = np.array([*robot.start, robot.heading])
        for k, u in enumerate(DIRECTIONS):

            def rates(_, s, u=u, robot=robot):
                return [
                    robot.speed * math.cos(s[2]),
                    robot.speed * math.sin(s[2]),
                    robot.a * math.sin(u - s[2]),
                ]

            times = np.arange(24) / 120
            done = solve_ivp(rates, (0, 0.2), state, "DOP853", [*times, 0.2], rtol=3e-14, atol=1e-9)
            assert path[24 * k : 24 * k + 24, i] == pytest.approx(done.y[:, :24].T, abs=1e-6)
            state = done.y[:, -1]


@pytest.mark.parametrize("motion", ["euler", "exact"])
def test_the_plant_reproduces_the_planners_prediction(motion):
    path = truths(steered(plant(motion=motion), DIRECTIONS))[::24]
    spec = experiment(controller={"motion": motion})
    predicted = predict(
        spec.controller.problem(spec.setup, Poses.from_array(path[0])), np.array(DIRECTIONS)
    )
    assert path == pytest.approx(predicted, abs=1e-9)


def test_wheel_speeds_are_24_and_25_at_the_measured_heading():
    simulated = plant(wheels={"radius": 40}, measurement_noise={"heading": 0.1})
    simulated.open()
    observation = simulated.observe()
    command = simulated.send(Steer(1.0))
    speed, turning = compute_body_velocity(command.left, command.right, 40)
    robots = experiment().robots
    assert speed == pytest.approx([robot.speed for robot in robots])
    a = np.array([robot.a for robot in robots])
    assert turning == pytest.approx(a * np.sin(1.0 - observation.poses.heading), abs=1e-12)
    assert plant().send(Steer(1.0)).left is None  # robots without wheels


@pytest.mark.parametrize("dead_time", [0.05, 0.1, 0.123, 0.2, 0.35])
def test_the_dead_time_delays_every_command_and_the_stop(dead_time):
    simulated = plant(STRAIGHT, dead_time=dead_time, camera_rate=1000, truth_rate=1000)
    samples = steered(simulated, [0.0, 0.0, 0.0])
    simulated.stop()
    verdict = simulated.settle()
    samples += simulated.samples()
    assert verdict.final.x[0] == pytest.approx(900 + 100 * 0.6, abs=1e-6)
    x = truths(samples)[:, 0, 0]
    moving = (np.abs(np.diff(x)) > 1e-9).nonzero()[0] / 1000
    assert moving[0] == pytest.approx(dead_time, abs=2e-3)
    assert moving[-1] == pytest.approx(0.6 + dead_time, abs=2e-3)


def test_a_lost_command_leaves_the_one_before_in_force():
    """A robot that no command has reached yet stands; others are one of the exact steps on."""
    simulated = plant(lost_commands=0.5, seed=3)
    simulated.open()
    setup = simulated.setup
    before = simulated.observe().poses.array()
    held = np.full(3, np.nan)
    lost = 0
    for k in range(20):
        direction = DIRECTIONS[k % 12]
        delivered = np.array(simulated.send(Steer(direction)).delivered)
        lost += np.count_nonzero(~delivered & np.isfinite(held))
        held = np.where(delivered, direction, held)
        simulated.clock.sleep_until((k + 1) * PERIOD)
        after = simulated.observe().poses.array()
        expected = np.column_stack(exact(*before.T, held, setup.a, setup.speed, 0.2))
        expected = np.where(np.isnan(held)[:, None], before, expected)
        assert after == pytest.approx(expected, abs=1e-9)
        before = after
    assert lost > 5


def test_commands_are_lost_as_often_as_stated_and_one_robot_at_a_time():
    simulated = plant(lost_commands=0.3)
    simulated.open()
    commands = [simulated.send(Steer(0.0)) for _ in range(2000)]
    delivered = np.array([command.delivered for command in commands])
    losses = np.count_nonzero(~delivered)
    assert scipy.stats.binomtest(losses, delivered.size, 0.3).pvalue > 1e-4
    assert abs(np.corrcoef(delivered[:, 0], delivered[:, 1])[0, 1]) < 0.08
    assert simulated.stop().delivered == (True, True, True)


def test_measurement_noise_is_normal_of_the_stated_size_and_moves_nobody():
    noise = {"position": 3.0, "heading": 0.05}
    samples = steered(plant(measurement_noise=noise), DIRECTIONS * 4)
    error = measured(samples) - truths(samples)
    assert len(error) > 1000
    for column, size in ((0, 3.0), (1, 3.0), (2, 0.05)):
        values = error[..., column].ravel() / size
        assert scipy.stats.kstest(values, "norm").pvalue > 1e-4
        assert abs(np.corrcoef(values[1:], values[:-1])[0, 1]) < 0.08
    clean = truths(steered(plant(), DIRECTIONS * 4))
    assert truths(samples).tobytes() == clean.tobytes()


def test_heading_noise_is_a_random_walk_of_the_stated_size():
    robots = [STRAIGHT[0] | {"name": f"robot {i}", "speed": 0} for i in range(40)]
    samples = steered(plant(robots, heading_noise=0.3), [0.0] * 50)  # 10 s
    headings = truths(samples)[..., 2]
    steps = np.diff(headings[1:], axis=0) / (0.3 / math.sqrt(120))
    assert scipy.stats.kstest(steps.ravel(), "norm").pvalue > 1e-4
    assert headings[-1].std() == pytest.approx(0.3 * math.sqrt(10), rel=0.35)


@pytest.mark.parametrize(("field", "nominal"), [("a_error", "a"), ("speed_error", "speed")])
def test_errors_of_a_and_speed_are_uniform_within_their_bound(field, nominal):
    ratios = []
    for seed in range(300):
        facts = plant(seed=seed, **{field: 0.2}).open().facts
        true = np.array(json.loads(facts[f"true_{nominal}"]))
        ratios.append(true / [getattr(robot, nominal) for robot in experiment().robots])
    errors = np.array(ratios) - 1
    assert np.abs(errors).max() <= 0.2
    assert scipy.stats.kstest(errors.ravel(), "uniform", args=(-0.2, 0.4)).pvalue > 1e-4
    assert abs(np.corrcoef(errors[:, 0], errors[:, 1])[0, 1]) < 0.2


def test_the_truth_decides_what_the_camera_misses():
    """A thin wall between two frames of a slow camera: only the fine path is in it."""
    wall = {"type": "rectangle", "left": 949, "bottom": 700, "width": 1, "height": 200}
    simulated = plant(STRAIGHT, [wall], camera_rate=2, truth_rate=500)
    path = truths(steered(simulated, [0.0] * 5))
    assert not np.any((path[..., 0] >= 949) & (path[..., 0] <= 950) & (path[..., 0] != 950))
    simulated.stop()
    verdict = simulated.settle()
    assert verdict.entered == (True,)
    assert verdict.clearance[0] <= 0


def test_the_verdict_tells_who_left_the_arena_and_how_near_robots_came():
    robots = [
        STRAIGHT[0] | {"start": [2000, 800]},  # the edge is at 2200
        STRAIGHT[0] | {"name": "slow", "start": [2000, 900], "speed": 50},
    ]
    simulated = plant(robots)
    steered(simulated, [0.0] * 15)
    simulated.stop()
    verdict = simulated.settle()
    assert verdict.edge == pytest.approx((-100, 50), abs=1e-6)
    assert verdict.apart == pytest.approx((100, 100), abs=1e-6)


@pytest.mark.parametrize("dead_time", [0.0, 0.1, 0.05])
def test_heading_noise_comes_with_every_frame(dead_time):
    """Regression: a command taking effect just at a frame made the frame lose its noise."""
    samples = steered(plant(STRAIGHT, heading_noise=0.3, dead_time=dead_time), [0.0] * 10)
    began = round(dead_time * 120) + 1
    steps = np.diff(truths(samples)[began:, 0, 2])
    assert np.all(np.abs(steps) > 1e-6)


@pytest.mark.parametrize(
    ("camera_rate", "sent_s", "dead_time"),
    [*((rate, 0.05, 0.14) for rate in (120, 60, 50, 30, 25)), (5, 0.19, 0.05)],
)
def test_the_dead_time_counts_from_the_exposure_of_the_frame_answered(
    camera_rate, sent_s, dead_time
):
    """Regression: it counted from `steer`, so the controller, which counts from the frame, was off
    by the frame's age wherever the camera's rate is no multiple of the control rate. A frame older
    than the dead time delays nothing further."""
    simulated = plant(STRAIGHT, dead_time=dead_time, camera_rate=camera_rate, truth_rate=1000)
    simulated.open()
    simulated.clock.sleep_until(round(sent_s * SECOND))
    exposed = simulated.observe().sampled_ns / SECOND
    simulated.send(Steer(0.0))
    simulated.clock.sleep_until(SECOND)
    simulated.observe()
    acted = max(exposed + dead_time, sent_s)
    assert simulated.poses.x[0] - 900 == pytest.approx(100 * (1 - acted), abs=1e-6)
