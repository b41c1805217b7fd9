"""Tests of which results contradict the frames, commands and steps of their own log."""

import re
from dataclasses import replace

import numpy as np
import pytest
from testkit import random_trials
from testkit.made_labs import lab_log, lost
from testkit.paths import ROOT
from testkit.trials import three_robots

from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, Steer
from tetractl.core.plan import Outcome
from tetractl.core.poses import Poses
from tetractl.core.protocols import EMULATED_NAME
from tetractl.core.trial import EMULATED_DEVICES_FACT, HALTS_FACT, PlantInfo
from tetractl.log.provenance import TRIAL_CODE_KEY
from tetractl.run.task import code_hash
from tetractl.spec.load import load_spec
from tetractl.spec.plants import select_plant
from tetractl.verification.result_check import result_differences

pytestmark = pytest.mark.slow


def differences_of(log, **fields):
    """Field and message of each difference if the log's result states these fields."""
    result = replace(log.result, **fields)
    return {d.field: d.message for d in result_differences(log, result)}


# ---- Errors ----


def test_an_honest_result_of_a_simulation_contradicts_nothing():
    assert differences_of(three_robots()) == {}


@pytest.mark.parametrize(
    "fields",
    [
        {"total_error": 1.0},
        {"robot_errors": (1.0, 2.0, 3.0)},
        {"steps": 40},
        {"solve_ns": (1,)},
        {"passed": (3.0,)},
    ],
    ids=lambda fields: next(iter(fields)),
)
def test_each_number_that_follows_from_the_records_is_compared(fields):
    (field,) = differences_of(three_robots(), **fields)
    assert field.startswith(f"result.{next(iter(fields))}")


def test_final_poses_of_a_simulation_are_the_true_ones_and_in_no_frame():
    log = three_robots()
    assert not any(np.array_equal(log.result.verdict.final.array(), row) for row in log.mocap)
    assert "result.final" not in differences_of(log)


# ---- Emulated devices ----


def with_plant(log, facts, experiment=None):
    plant = PlantInfo("lab", False, 100.0, facts)
    return replace(
        log, start=replace(log.start, plant=plant), experiment=experiment or log.experiment
    )


@pytest.fixture
def lab(tmp_path):
    return lab_log(tmp_path, lost(0, 100), 0.0, "yes", 0.001)


@pytest.mark.parametrize(
    ("facts", "is_named"),
    [
        ({}, True),
        ({"camera": "NatNet 4.1"}, True),
        ({"camera": f"NatNet, {EMULATED_NAME}"}, False),
        ({"camera": EMULATED_NAME, EMULATED_DEVICES_FACT: "camera"}, True),
    ],
)
def test_a_device_that_calls_itself_emulated_has_to_be_named_as_such(lab, facts, is_named):
    field = f"run.facts.{EMULATED_DEVICES_FACT}"
    assert (field not in differences_of(with_plant(lab, facts))) == is_named


# ---- Places ----


def final_at(log, poses, **fields):
    verdict = replace(log.result.verdict, final=Poses.from_array(poses))
    return differences_of(log, verdict=verdict, **fields)


def test_a_pose_that_differs_in_one_number_of_one_robot_is_another_place(lab):
    assert "result.final" not in final_at(lab, lab.mocap[-1])
    for robot, number in ((0, 0), (1, 1), (2, 2)):
        poses = lab.mocap[-1].copy()
        poses[robot, number] = np.nextafter(poses[robot, number], 9)
        assert "result.final" in final_at(lab, poses)


def test_the_last_pose_of_a_robot_that_nobody_tracked_may_be_unknown(lab):
    mocap = lab.mocap.copy()
    mocap[-1, 2] = np.nan
    unseen = replace(lab, mocap=mocap)
    assert "result.final" not in final_at(unseen, mocap[-1])


def test_a_lab_without_frames_has_no_places_to_compare(lab):
    none = replace(
        lab,
        mocap=lab.mocap[:0],
        valid=lab.valid[:0],
        frames=lab.frames[:0],
        mocap_ns=lab.mocap_ns[:0],
        received_ns=lab.received_ns[:0],
    )
    assert "result.final" not in final_at(none, np.zeros((3, 3)))


@pytest.fixture
def lab_across_a_wall(tmp_path):
    """A lab in which robot 1 of three drives through a wall, and the other two stand far off."""
    trial = random_trials.trial(simulated=False)
    log = random_trials.write_and_read(trial, tmp_path / "wall.mcap")
    n = len(log.frames)
    mocap = np.zeros((n, 3, 3))
    mocap[..., 0], mocap[..., 1] = 700.0, 400.0
    mocap[:, 2, 1] = 600.0
    mocap[:, 1, 0] = np.linspace(1000.0, 1600.0, n)  # the wall: x 1200 to 1400, y 1100 to 1300
    mocap[:, 1, 1] = 1200.0
    log = replace(log, mocap=mocap, valid=np.ones((n, 3), bool))
    return with_plant(log, {HALTS_FACT: "yes"})


@pytest.mark.parametrize("stated", [(f, g, h) for f in (0, 1) for g in (0, 1) for h in (0, 1)])
def test_robots_that_entered_an_obstacle_are_those_whose_path_did(lab_across_a_wall, stated):
    log = lab_across_a_wall
    entered = tuple(map(bool, stated))
    verdict = replace(
        log.result.verdict,
        final=Poses.from_array(log.mocap[-1]),
        entered=entered,
        clearance=(-1.0,) * 3,
    )
    wrong = {field for field in differences_of(log, verdict=verdict) if "entered" in field}
    right = (False, True, False)
    assert wrong == {f"result.entered.{i}" for i in range(3) if entered[i] != right[i]}


# ---- Turns ----


RADIUS = 40.0  # from a wheel to the centre of a robot [mm]
SPEED = 150.0  # of each robot [mm/s]
SLOWER_LEFT = (0.0, 0.02, -0.02)  # half the difference between the errors of a robot's wheels
RATE_HZ = 100
SECONDS = 3


def driven_by_wheels(rng):
    """The commanded wheel speeds of three robots in each period, and their poses.

    One wheel of a robot is slower than commanded and the other one faster.
    """
    turning = rng.uniform(-1.0, 1.0, (5 * SECONDS, 3))
    left, right = SPEED - RADIUS * turning, SPEED + RADIUS * turning
    pose = np.array([[900.0, 800, 0.1], [1200.0, 1200, 0.2], [900.0, 1700, 0.3]])
    poses = []
    errors = np.array(SLOWER_LEFT)
    for frame in range(SECONDS * RATE_HZ):
        poses.append(pose.copy())
        k = frame * 5 // RATE_HZ
        true_left, true_right = left[k] * (1 - errors), right[k] * (1 + errors)
        speed, rate = (true_left + true_right) / 2, (true_right - true_left) / (2 * RADIUS)
        heading = pose[:, 2] + rate / RATE_HZ / 2
        pose[:, 0] += speed / RATE_HZ * np.cos(heading)
        pose[:, 1] += speed / RATE_HZ * np.sin(heading)
        pose[:, 2] += rate / RATE_HZ
    noise = rng.normal(0.0, 1.0, (len(poses), 3, 3)) * (0.1, 0.1, 0.001)
    return left, right, np.array(poses) + noise


@pytest.fixture(scope="module")
def wheeled_lab(tmp_path_factory):
    """A log of a lab in which three robots on wheels drove for 3 s, written by this code."""
    trial = random_trials.trial(simulated=False, wheels={"radius": RADIUS})
    log = random_trials.write_and_read(trial, tmp_path_factory.mktemp("log") / "trial.mcap")
    spec = select_plant(load_spec(ROOT / "experiments" / "three_m3pi_lab.yaml"), "lab").experiment
    left, right, poses = driven_by_wheels(np.random.default_rng(81733))
    n = len(poses)
    times_ns = np.arange(n) * (SECOND // RATE_HZ)
    sent = [
        Command(Steer(0.0), k * SECOND // 5, (True,) * 3, left[k], right[k])
        for k in range(len(left))
    ]
    log = replace(
        log,
        mocap=poses,
        valid=np.ones((n, 3), bool),
        frames=np.arange(n),
        mocap_ns=times_ns,
        received_ns=times_ns + 1,
        exposed_ns=times_ns[:, None].repeat(3, axis=1),
        commands=tuple(sent),
        stop=None,
        facts=log.facts | {TRIAL_CODE_KEY: code_hash(spec)},
    )
    return with_plant(log, {HALTS_FACT: "yes"}, spec)


def turns_of(log, turn, turn_std, **fields):
    verdict = replace(log.result.verdict, turn=turn, turn_std=turn_std)
    found = differences_of(log, verdict=verdict, **fields)
    return {field: text for field, text in found.items() if field.startswith("result.turn")}


@pytest.fixture(scope="module")
def turning(wheeled_lab):
    """Rates and standard errors that the frames of the wheeled lab show."""
    found = turns_of(wheeled_lab, (1e9,) * 3, (1e9,) * 3)
    rates = [float(found[f"result.turn.{i}"].split()[-1]) for i in range(3)]
    errors = [float(found[f"result.turn_std.{i}"].split()[-1]) for i in range(3)]
    assert np.isfinite(errors).all()
    return tuple(rates), tuple(errors)


def test_robots_turn_as_the_errors_of_their_wheels_make_them(turning):
    """At the highest speed v, half a difference d turns a robot by v d / r."""
    rates, errors = turning
    expected = SPEED / RADIUS * np.array(SLOWER_LEFT)
    assert 0 < min(errors) <= max(errors) < 0.05
    assert (np.abs(rates - expected) < 3 * np.array(errors)).all()


def test_turns_that_the_frames_show_are_accepted(wheeled_lab, turning):
    assert turns_of(wheeled_lab, *turning) == {}


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_turn_may_differ_by_a_standard_error_and_its_error_by_a_tenth(wheeled_lab, turning, sign):
    rates, errors = map(np.array, turning)

    def stated(of_rate, of_error):
        changed = rates + sign * of_rate * errors, errors * (1 + sign * of_error)
        return turns_of(wheeled_lab, *map(tuple, changed))

    assert stated(0.95, 0.09) == {}
    far = {f"result.{field}.{i}" for field in ("turn", "turn_std") for i in range(3)}
    assert set(stated(1.05, 0.11)) == far


def test_a_turn_that_is_no_number_contradicts_the_frames(wheeled_lab, turning):
    rates, errors = turning
    wrong = turns_of(wheeled_lab, (float("nan"), *rates[1:]), errors)
    assert set(wrong) == {"result.turn.0"}


def test_turns_of_robots_that_the_frames_do_not_have_are_counted(wheeled_lab, turning):
    rates, errors = turning
    assert re.fullmatch(
        "states 2 turns, but the frames show 3",
        turns_of(wheeled_lab, rates[:2], errors[:2])["result.turn"],
    )
    assert set(turns_of(wheeled_lab, (), ())) == {"result.turn"}


def test_turns_are_computed_again_only_by_the_code_that_wrote_the_log(wheeled_lab):
    older = replace(wheeled_lab, facts=wheeled_lab.facts | {TRIAL_CODE_KEY: "older"})
    assert turns_of(older, (9.0,) * 3, (9.0,) * 3) == {}


def test_turns_of_a_trial_that_a_guard_may_have_ended_are_not_computed_again(wheeled_lab):
    for outcome in (Outcome.ABORTED, Outcome.INTERRUPTED):
        assert turns_of(wheeled_lab, (9.0,) * 3, (9.0,) * 3, outcome=outcome) == {}


def test_robots_without_wheels_show_no_turn(wheeled_lab):
    setup = replace(wheeled_lab.start.setup, wheel_radius=None)
    swimming = replace(wheeled_lab, start=replace(wheeled_lab.start, setup=setup))
    assert turns_of(swimming, (), ()) == {}
    assert set(turns_of(swimming, (0.0,) * 3, (0.1,) * 3)) == {"result.turn"}
