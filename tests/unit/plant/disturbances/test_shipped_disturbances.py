"""Tests that each disturbance of the bench is as large and as frequent as the spec says."""

import math

import numpy as np
import pytest
import scipy
from testkit.paths import ROOT
from testkit.plants import PAIR, PERIOD, sim
from testkit.trials import experiment

from tetractl.core.clock import SECOND
from tetractl.core.commands import Steer
from tetractl.core.poses import Poses
from tetractl.plant.disturbances.robots import HeadingDrift, WanderSection
from tetractl.spec.load import load_spec
from tetractl.spec.yaml.problems import InvalidSpecError

pytestmark = pytest.mark.slow


def plant(*disturbances, seed=1, robots=PAIR, wheels=None, **fields):
    section = {"disturbances": list(disturbances), **fields}
    spec = experiment(robots=robots, obstacles=[], plant=section, wheels=wheels)
    return sim(spec, seed)


START_X = 900  # of both robots of PAIR [mm], which head to the right
SPEEDS = np.array([100, 50])  # of PAIR [mm/s]


def latencies(samples):
    """From the exposure of each frame but the first until the host has it [ns]."""
    frames = [sample.observation for sample in samples[1:]]
    return np.array([frame.received_ns - frame.sampled_ns for frame in frames])


def deliveries(simulated, count):
    """Which of so many directions, sent one right after the other, have reached each robot."""
    simulated.open()
    commands = [simulated.send(Steer(0.0)) for _ in range(count)]
    return np.array([command.delivered for command in commands])


def rate_agrees(happened, share):
    """Whether it happened as often as by chance, with this share for each."""
    count = int(np.count_nonzero(happened))
    return scipy.stats.binomtest(count, np.size(happened), share).pvalue > 1e-4


def driven(simulated, seconds, direction=0.0):
    """Hold a direction; return every sample."""
    simulated.open()
    simulated.send(Steer(direction))
    simulated.clock.sleep_until(round(seconds * SECOND))
    return simulated.samples()


def test_frames_reach_the_host_as_late_as_the_spec_says():
    section = {"type": "camera-latency", "mean": 0.02, "deviation": 0.001}
    samples = driven(plant(section), 20)
    latency = latencies(samples)
    assert latency.mean() / SECOND == pytest.approx(0.02, abs=1e-4)
    assert latency.std() / SECOND == pytest.approx(0.001, rel=0.1)
    received = [s.observation.received_ns for s in samples]
    assert received == sorted(received)
    assert received[-1] <= 20 * SECOND < received[-1] + SECOND / 50


@pytest.mark.parametrize(("burst", "share"), [(1.0, 0.4), (4.0, 0.1)])
def test_frames_are_lost_as_often_and_as_many_in_a_row_as_the_spec_says(burst, share):
    samples = driven(plant({"type": "frame-loss", "share": share, "burst": burst}), 200)
    numbers = np.array([s.observation.frame for s in samples])
    assert numbers[0] == 0
    gaps = np.diff(numbers) - 1
    assert gaps.sum() / numbers[-1] == pytest.approx(share, rel=0.15)
    assert gaps[gaps > 0].mean() == pytest.approx(burst, rel=0.2)


def test_planning_takes_time_before_a_command_and_before_the_stop():
    simulated = plant({"type": "planning-time", "least": 0.01, "spread": 0.02})
    simulated.open()
    taken = []
    for k in range(200):
        simulated.clock.sleep_until(k * PERIOD)
        taken.append(simulated.send(Steer(0.0)).sent_ns - k * PERIOD)
    assert scipy.stats.kstest(np.array(taken) / SECOND, "uniform", (0.01, 0.02)).pvalue > 1e-4
    now = simulated.clock.now()
    assert 0.01 <= (simulated.stop().sent_ns - now) / SECOND <= 0.03


def test_the_radio_loses_for_each_robot_alone():
    simulated = plant({"type": "radio", "delay": 0.05, "loss": 0.3})
    delivered = deliveries(simulated, 2000)
    assert rate_agrees(~delivered, 0.3)
    assert abs(np.corrcoef(delivered.T)[0, 1]) < 0.08


def seconds_stood(simulated):
    """How long each robot has stood of the first second, with one direction sent at once."""
    x = driven(simulated, 1)[-1].truth.x
    return 1 - (x - START_X) / SPEEDS


def test_the_radio_delays_for_each_robot_alone():
    stood_s = seconds_stood(plant({"type": "radio", "spread": 0.1}))
    assert stood_s.min() >= 0
    assert stood_s.max() <= 0.1 + 0.01  # up to a frame more
    assert stood_s[0] != pytest.approx(stood_s[1], abs=0.01)


def test_robots_are_put_down_near_their_starts():
    section = {"type": "start-error", "position": 10, "heading": 0.1}
    off = []
    for seed in range(300):
        poses = plant(section, seed=seed).poses
        off.append([poses.x - START_X, poses.y - [800, 900], 100 * poses.heading])
    off = np.array(off)  # (trials, 3, robots), each uniform from -10 to 10
    assert scipy.stats.kstest(off.ravel(), "uniform", (-10, 20)).pvalue > 1e-4
    x_of_robots = off[:, 0].T
    assert abs(np.corrcoef(x_of_robots)[0, 1]) < 0.2


def test_a_positive_heading_drift_turns_a_moving_robot_to_the_left():
    drift = HeadingDrift(np.array([0.2, -0.1, 0.3]))
    poses = Poses(np.zeros(3), np.zeros(3), np.array([1.0, 1.0, 1.0]))
    drifted = drift.moved(poses, np.array([1.0, 1.0, 0.0]), 2.0, 0.0)
    assert drifted.heading == pytest.approx([1.4, 0.8, 1.0])


@pytest.mark.long
def test_each_robot_drifts_always_to_its_own_side():
    rates = []
    for seed in range(100):
        path = driven(plant({"type": "heading-drift", "rate": 0.2}, seed=seed), 1)
        rates.append(path[-1].truth.heading / (len(path) - 1) * 120)
    assert scipy.stats.kstest(np.array(rates).ravel(), "uniform", (-0.2, 0.4)).pvalue > 1e-4


UPWARDS = {"type": "flow", "speed": 10, "direction": math.pi / 2}


def test_a_flow_does_not_carry_those_who_stand():
    simulated = plant(UPWARDS)
    start_y = simulated.poses.y
    simulated.open()
    simulated.clock.sleep_until(SECOND)
    assert simulated.observe().poses.y == pytest.approx(start_y)


def test_cells_weave_and_their_bodies_point_along_their_paths():
    section = {"type": "wobble", "radius": 5, "frequency": 2}
    samples = driven(plant(section, seed=4), 5)[2:]
    across = np.array([sample.truth.y for sample in samples]) - [800, 900]
    assert np.ptp(across, axis=0) == pytest.approx([10, 10], rel=0.02)
    side = np.sign(across - across.mean(axis=0))
    crossings = np.count_nonzero(np.diff(side, axis=0), axis=0)
    assert crossings == pytest.approx([20, 20], abs=1)  # two in each of 10 periods
    path = np.array([sample.truth.xy for sample in samples])
    along = np.diff(path, axis=0)
    course = np.arctan2(along[..., 1], along[..., 0])
    body = np.array([sample.observation.poses.heading for sample in samples])
    middle = (body[1:] + body[:-1]) / 2
    assert middle == pytest.approx(course, abs=0.12)
    assert np.ptp(middle[:, 1]) > 1.5  # the slower one weaves more steeply


def test_no_robot_hears_anything_while_the_radio_is_silent():
    section = {"type": "silent-radio", "times": 2, "duration": 0.5, "between": [1, 4]}
    simulated = plant(section, seed=3)
    simulated.open()
    heard = []
    for k in range(600):
        simulated.clock.sleep_until(k * SECOND // 100)
        heard.append(simulated.send(Steer(0.0)).delivered)
    silent = ~np.array(heard).any(axis=1)
    assert np.array_equal(silent, ~np.array(heard).all(axis=1))
    begins = np.flatnonzero(np.diff(silent.astype(int)) == 1) + 1
    assert len(begins) == 2
    assert silent.sum() == pytest.approx(100, abs=2)
    assert begins.min() >= 100
    assert begins.max() <= 400


@pytest.mark.parametrize("drive", [None, {}, {"rate": 40}, {"lag": 0.04}])
@pytest.mark.parametrize("watchdog", [None, 0.25])
def test_a_robot_that_hears_nothing_stops_by_its_watchdog_until_it_hears_again(drive, watchdog):
    silence = {"type": "silent-radio", "duration": 1.0, "between": [1, 1]}
    wheels = {"radius": 40, "watchdog": watchdog}
    simulated = plant(silence, wheels=wheels, drive=drive)
    simulated.open()
    for k in range(30):
        simulated.clock.sleep_until(k * SECOND // 10)
        simulated.send(Steer(0.0))
    simulated.clock.sleep_until(3 * SECOND)
    samples = simulated.samples()
    way = samples[-1].truth.x - START_X
    between_s = 0.1  # two directions
    lag_s = (drive or {}).get("lag", 0.0)
    by_watchdog_s = 1.0 - 0.25 + between_s  # the last was heard before the silence
    stood_s = lag_s if watchdog is None else by_watchdog_s
    assert way == pytest.approx(SPEEDS * (3 - stood_s), abs=100 * between_s)
    way_in_silence = samples[round(2.0 * 120)].truth.x - samples[round(1.5 * 120)].truth.x
    stands = way_in_silence < 0.1
    assert stands.tolist() == [watchdog is not None] * 2


def test_a_watchdog_shorter_than_the_time_between_two_commands_is_refused():
    with pytest.raises(InvalidSpecError, match="would stop them between two commands"):
        load_spec(ROOT / "experiments" / "three_m3pi.yaml", ["wheels.watchdog=0.05"])


@pytest.mark.long
def test_each_robot_sticks_as_often_and_as_long_as_the_spec_says():
    section = {"type": "sticking", "every": 1.0, "duration": 0.5}
    samples = driven(plant(section, seed=2, camera_rate=50, truth_rate=50), 300)
    x = np.array([sample.truth.x for sample in samples])[1:]
    stuck = np.abs(np.diff(x, axis=0)) < 1e-9
    assert stuck.mean(axis=0) == pytest.approx([1 / 3, 1 / 3], abs=0.05)
    assert np.abs(np.corrcoef(stuck.T)[0, 1]) < 0.1
    for robot in stuck.T:
        edges = np.flatnonzero(np.diff(robot.astype(int)))
        spells = np.diff(edges)[1 if robot[0] else 0 :: 2] / 50
        assert np.median(spells) == pytest.approx(0.5, abs=0.021)


@pytest.mark.parametrize(
    ("section", "behind"),
    [
        ({"type": "stale-camera", "age": 0.1}, lambda since: np.full_like(since, 0.1)),
        ({"type": "frozen-camera"}, lambda since: since),
    ],
)
def test_the_camera_shows_old_poses_as_new_for_a_spell(section, behind):
    samples = driven(plant(section | {"duration": 0.4, "between": [1, 1]}), 3)
    times = np.array([sample.observation.sampled_ns for sample in samples]) / SECOND
    measured_x = np.array([sample.observation.poses.x for sample in samples])
    true_x = np.array([sample.truth.x for sample in samples])
    lag_s = (true_x - measured_x) / SPEEDS
    during = (times >= 1) & (times < 1.4)
    assert np.diff(times) == pytest.approx(1 / 120, abs=1e-6)
    assert np.all(lag_s[~during] == 0)
    expected = behind(times[during] - 1)
    assert lag_s[during] == pytest.approx(np.column_stack([expected] * 2), abs=1.1 / 120)


def test_markers_are_off_to_either_side_in_the_picture_alone():
    off = []
    for seed in range(50):
        sample = driven(plant({"type": "marker-off", "heading": 0.1}, seed=seed), 0.1)[-1]
        off.extend(sample.observation.poses.heading - sample.truth.heading)
    assert np.abs(off) == pytest.approx(0.1)
    assert rate_agrees(np.array(off) > 0, 0.5)


@pytest.mark.long
def test_robots_slow_down_as_batteries_do():
    """By a fifth in 10 s, at 120 frames a second, and no further."""
    samples = driven(plant({"type": "battery", "speed": 0.2, "over": 10.0}), 20)
    x = np.array([sample.truth.x for sample in samples])
    speed = np.diff(x, axis=0) * 120 / SPEEDS
    assert speed[5 * 120] == pytest.approx([0.9, 0.9], abs=1e-3)
    assert speed[11 * 120 :] == pytest.approx(0.8, abs=1e-3)


@pytest.mark.parametrize("field", ["a", "speed"])
def test_a_and_speed_wander_as_far_and_as_fast_as_the_spec_says(field):
    section = WanderSection.model_validate({"type": "wander", field: 0.1, "time": 0.5})
    setup = experiment(robots=PAIR, obstacles=[]).setup
    disturbance = section.build(setup, np.random.default_rng(5))
    ones = np.ones(2)
    ln_factors = np.log([disturbance.varied(ones, ones, k / 20) for k in range(20_000)])
    of_a = ln_factors[:, 0]
    of_speed = ln_factors[:, 1]
    error = of_a if field == "a" else of_speed
    unchanged = of_speed if field == "a" else of_a
    assert np.all(unchanged == 0)
    assert error.std(axis=0) == pytest.approx([0.1, 0.1], rel=0.1)
    correlations = [np.corrcoef(robot[:-10], robot[10:])[0, 1] for robot in error.T]
    assert correlations == pytest.approx([np.exp(-1)] * 2, abs=0.1)
    assert np.abs(np.corrcoef(error.T)[0, 1]) < 0.1


@pytest.mark.long
def test_tracking_is_lost_as_often_and_as_long_as_the_spec_says():
    section = {"type": "tracking-loss", "every": 0.3, "duration": 0.1}
    samples = driven(plant(section, seed=3), 200)
    valid = np.array([sample.observation.valid for sample in samples])
    assert valid[0].all()
    assert valid.mean(axis=0) == pytest.approx(0.75, abs=0.05)
    losses = (np.diff(valid.astype(int), axis=0) == -1).sum(axis=0)
    assert losses == pytest.approx(200 / 0.4, rel=0.15)
    assert np.abs(np.corrcoef(valid.T)[0, 1]) < 0.05
