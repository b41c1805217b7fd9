"""Tests of the order of events in a simulation, and of what disturbances receive."""

from types import SimpleNamespace

import numpy as np
import pytest
from testkit.built_disturbance import BuiltSection
from testkit.plants import PAIR, sim
from testkit.trials import experiment

from tetractl.core.clock import SECOND
from tetractl.core.commands import Steer
from tetractl.core.errors import WrongValueError
from tetractl.core.poses import POSE_MAX, Poses
from tetractl.plant.true_motion import UNCHECKED_PARTS_MAX, MotionDisturbances
from tetractl.spec.disturbance import Disturbance

A = np.array([2.0, 3.0])
SPEED = np.array([100.0, 50.0])


def still_drive(moving=(1.0, 0.0), commanded=(1.0, 1.0)):
    """Stands for a drive; `varied` are the abilities that it was given."""
    drive = SimpleNamespace(
        poses=Poses(np.zeros(2), np.zeros(2), np.zeros(2)),
        moving=np.array(moving),
        commanded=np.array(commanded),
        given=[],
    )
    drive.vary = lambda a, speed: drive.given.append((a.tolist(), speed.tolist()))
    return drive


class Carries(Disturbance):
    """Carries robots by 10 length units a second, and notes what it receives."""

    def __init__(self):
        self.told = []

    def moved(self, poses, moving, seconds, time_s):
        self.told.append((moving.tolist(), round(seconds, 9), round(time_s, 9)))
        return Poses(poses.x + 10 * seconds, poses.y, poses.heading)


class Holds(Carries):
    """Also holds the first robot still from 1 s on, and halves the speed of the second."""

    def varied(self, a, speed, time_s):
        factor = np.array([0.0 if time_s >= 1 else 1.0, 0.5])
        return a * factor, speed * factor


def test_disturbances_are_told_how_long_ago_they_last_moved_the_robots_and_act_once():
    carries = Carries()
    drive = still_drive()
    disturbances = MotionDisturbances([carries], A, SPEED)
    for now_s in (0.0, 0.5, 0.5, 2.0):
        disturbances.apply(drive, round(now_s * SECOND))
    moving = [1.0, 0.0]
    assert carries.told == [(moving, 0.0, 0.0), (moving, 0.5, 0.5), (moving, 1.5, 2.0)]
    assert drive.poses.x.tolist() == [20, 20]
    assert drive.given == [], "nothing varies"
    assert disturbances.rates == (A, SPEED)


def test_rates_vary_from_those_of_the_spec_each_time_and_through_all_disturbances():
    drive = still_drive()
    disturbances = MotionDisturbances([Holds(), Holds()], A, SPEED)
    disturbances.apply(drive, 0)
    disturbances.apply(drive, SECOND // 2)
    assert drive.given == [([2.0, 0.75], [100.0, 12.5])] * 2
    disturbances.apply(drive, SECOND)
    assert drive.given[-1] == ([0.0, 0.75], [0.0, 12.5])
    assert [rates.tolist() for rates in disturbances.rates] == [[0.0, 0.75], [0.0, 12.5]]


def test_a_robot_counts_as_moving_for_the_disturbance_that_holds_it_and_not_for_others():
    holds, other = Holds(), Carries()
    drive = still_drive(moving=(0.0, 0.0), commanded=(1.0, 1.0))
    disturbances = MotionDisturbances([holds, other], A, SPEED)
    for k in range(3):
        disturbances.apply(drive, k * SECOND)
    assert [moving for moving, *_ in holds.told] == [[0, 0], [0, 0], [1, 0]]
    assert [moving for moving, *_ in other.told] == [[0, 0]] * 3


def test_a_robot_that_an_earlier_disturbance_holds_is_not_held_by_a_later_one():
    first, second = Holds(), Holds()
    drive = still_drive(moving=(0.0, 1.0), commanded=(1.0, 1.0))
    disturbances = MotionDisturbances([first, second], A, SPEED)
    for k in (1, 2):
        disturbances.apply(drive, k * SECOND)
    assert first.told[-1][0] == [1, 1]
    assert second.told[-1][0] == [0, 1]


@pytest.mark.parametrize(
    ("disturbances", "has_any"),
    [([], False), ([Disturbance()], False), ([Carries()], True), ([Disturbance(), Holds()], True)],
)
def test_only_disturbances_that_move_or_vary_count(disturbances, has_any):
    assert MotionDisturbances(disturbances, A, SPEED).has_effect is has_any


def plant(*disturbances, seed=3, wheels=None, obstacles=(), **fields):
    sections = [BuiltSection.holding(disturbance) for disturbance in disturbances]
    section = {"disturbances": sections, **fields}
    spec = experiment(robots=PAIR, obstacles=list(obstacles), plant=section, wheels=wheels)
    return sim(spec, seed)


def run(simulated, every_ns, until_ns=SECOND):
    """Steer, and read the plant at these intervals; return its final poses and its samples."""
    simulated.open()
    simulated.send(Steer(0.4))
    for now_ns in range(every_ns, until_ns + 1, every_ns):
        simulated.clock.sleep_until(now_ns)
        simulated.observe()
    return simulated.samples()


@pytest.mark.parametrize(
    "fields",
    [
        {},
        {"heading_noise": 0.3},
        {"drive": {"rate": 40}, "heading_noise": 0.3},
        {"drive": {}, "dead_time": 0.05},
    ],
)
@pytest.mark.parametrize("every_ns", [SECOND // 250, SECOND // 77])
def test_the_true_motion_does_not_depend_on_how_often_the_plant_is_read(fields, every_ns):
    wheels = {"radius": 40} if "drive" in fields else None
    often, once = (
        run(plant(wheels=wheels, **fields), interval_ns) for interval_ns in (every_ns, SECOND)
    )
    assert [sample.observation.sampled_ns for sample in often] == [
        sample.observation.sampled_ns for sample in once[: len(often)]
    ]
    assert len(often) >= 119
    for one, other in zip(often, once, strict=False):
        assert one.truth.array() == pytest.approx(other.truth.array(), abs=1e-9)


def test_headings_walk_while_robots_move_by_the_noise_of_the_square_root_of_time():
    simulated = plant(heading_noise=0.3, camera_rate=50, truth_rate=50)
    simulated.open()
    simulated.clock.sleep_until(SECOND)
    assert simulated.observe().poses.heading.tolist() == [0, 0], "they stand"
    simulated.samples()
    simulated.send(Steer(0.0))
    simulated.clock.sleep_until(11 * SECOND)
    headings = np.array([sample.truth.heading for sample in simulated.samples()])
    steps = np.diff(headings, axis=0)
    assert steps.std() == pytest.approx(0.3 * np.sqrt(1 / 50), rel=0.1)
    assert abs(np.corrcoef(steps[:-1, 0], steps[1:, 0])[0, 1]) < 0.15
    assert abs(np.corrcoef(steps.T)[0, 1]) < 0.15


@pytest.mark.parametrize("x", [np.nan, np.inf, 1.1 * POSE_MAX, -1.1 * POSE_MAX])
def test_a_pose_that_no_log_can_hold_is_refused_and_the_largest_is_not(x):
    class Puts(Disturbance):
        def __init__(self, x):
            self.x = x

        def moved(self, poses, moving, seconds, time_s):
            return Poses(np.array([self.x, 0.0]), poses.y, poses.heading)

    plant(Puts(POSE_MAX)).open()
    with pytest.raises(WrongValueError, match="cannot be logged"):
        plant(Puts(x)).open()


def test_a_disturbance_that_returns_poses_of_fewer_robots_is_refused():
    class Loses(Disturbance):
        def moved(self, poses, moving, seconds, time_s):
            return Poses(poses.x[:1], poses.y[:1], poses.heading[:1])

    with pytest.raises((WrongValueError, ValueError)):
        plant(Loses()).open()


@pytest.mark.parametrize("parts", [3, UNCHECKED_PARTS_MAX + 50])
def test_the_whole_path_is_checked_however_many_parts_it_has(parts):
    """Both robots pass the obstacle, from 30 to 35 mm ahead of them, in the first second."""
    wall = {"type": "rectangle", "left": 930, "bottom": 700, "width": 5, "height": 300}
    ahead = {**wall, "left": 900 + 250}
    for obstacle, entered, clearance in [(wall, True, -2.5), (ahead, False, 50.0)]:
        simulated = plant(obstacles=[obstacle])
        simulated.open()
        simulated.send(Steer(0.0))
        for k in range(1, parts + 1):
            simulated.clock.sleep_until(k * 2 * SECOND // parts)
            simulated.observe()
        simulated.stop()
        verdict = simulated.settle()
        assert verdict.entered == (entered, entered)
        assert verdict.clearance[0] == pytest.approx(clearance, abs=0.1)
        assert verdict.apart[0] == pytest.approx(100.0, abs=0.5)
