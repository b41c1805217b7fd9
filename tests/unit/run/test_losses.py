"""Tests of lost robots: the trial ends, goes on without them, or replaces them."""

import numpy as np
import pytest
from testkit.marked_robots import install
from testkit.mutate import with_entry
from testkit.paths import ROOT
from testkit.trials import experiment

from tetractl.core.clock import SECOND
from tetractl.core.errors import SpecError
from tetractl.core.losses import LossRule, LossTracker
from tetractl.core.poses import Observation, Poses
from tetractl.log.format.channels import RESULT
from tetractl.log.read.reader import read_result, read_trial
from tetractl.log.read.salvage import scan
from tetractl.run.logged_trial import log_path, run_logged
from tetractl.spec.load import load_spec, parse_spec
from tetractl.statistics.built_in_statistics import LOST
from tetractl.statistics.flagged import trial_notes
from tetractl.verification.verify import verify

REST = """
name: three
units: {length: um}
arena: {left: 0, bottom: 0, width: 3000, height: 3000}
controller: {type: mpc, period: 0.2, horizon_max: 30, time_limit: 8.2, accept_error: 60,
  optimizer: {type: multistart, tolerance: 1}}
plant: {camera_rate: 30, disturbances: [{type: tracking-loss, every: 2.5, duration: 0.6}]}
"""
LISTED = """robots:
- {name: one, start: [800, 800], target: [1500, 1900], a: 5, speed: 400}
- {name: two, start: [1900, 900], target: [1200, 1000], a: 3.5, speed: 420}
- {name: three, start: [1500, 2100], target: [2100, 2100], a: 2.5, speed: 380}
"""

MARKED = "robots: {marks: [[800, 800], [1900, 900], [1500, 2100]]}\n"

GOES_ON = LossRule(0.3, replaces_lost=False, includes_dead=True)


def seen(t, valid):
    """What is seen at t [s] of robots of which these are `valid`."""
    time_ns = round(t * SECOND)
    poses = Poses.from_array(np.zeros((len(valid), 3)))
    return Observation(0, time_ns, time_ns, poses, np.array(valid))


VALID = {  # by the time [s]: the first robot is not seen for up to 0.3 s before 0.5 s
    0.0: (False, True),
    0.2: (True, True),
    0.4: (False, False),
    0.49: (False, True),
    0.5: (True, True),
    0.6: (True, True),
}


@pytest.mark.parametrize(
    ("rule", "lost", "times", "others"),
    [
        (None, [False, False], [0, 0], []),
        (LossRule(0.3, replaces_lost=False), [True, False], [1, 0], []),
        (LossRule(0.3, replaces_lost=True), [False, False], [1, 0], [(0.5, 0)]),
    ],
)
def test_a_robot_is_lost_after_a_while_for_good_or_until_another_is_there(
    rule, lost, times, others
):
    losses = LossTracker(rule, np.ones(2))
    replaced = []
    for t, valid in VALID.items():
        replaced += [(t, robot) for robot in losses.add_frame(seen(t, valid))]
    assert replaced == others
    assert losses.lost.tolist() == lost
    assert losses.loss_counts.tolist() == times


def driven(way_s, until_s=20.0, rule=GOES_ON):
    """The losses after robots of 100 mm/s have driven so far in the time t, way_s(t) (N,) [s]; seen
    at 120 Hz with a noise of 0.3 mm."""
    random = np.random.default_rng(1)
    robots = len(way_s(0.0))
    losses = LossTracker(rule, np.full(robots, 100.0))
    for k in range(round(120 * until_s)):
        t = k / 120
        way = 100 * np.array(way_s(t)) + random.normal(0, 0.3, robots)
        poses = Poses(way, 0 * way, 0 * way)
        present = np.ones(robots, dtype=bool)
        losses.add_frame(Observation(k, round(t * SECOND), 0, poses, present))
    return losses


def stands(t, begin, end):
    """How long one has driven by t that stands from `begin` to `end`."""
    return t - min(max(t - begin, 0.0), end - begin)


NOBODY = [False, False, False]
STANDING = [
    (lambda t: (stands(t, 3, 99), t, t), [True, False, False]),
    (lambda t: (stands(t, 3, 99), t, stands(t, 9, 99)), [True, False, True]),
    (lambda t: (stands(t, 3, 5), t, stands(t, 3, 7)), NOBODY),  # they stick, for up to 4 s
    (lambda t: (stands(t, 3, 99),) * 3, NOBODY),  # the radio is silent
    (lambda t: (stands(t, 3, 99), stands(t, 7, 99), stands(t, 7, 99)), NOBODY),  # a hold
    (lambda t: (0.2 * t, t, 2 * t), NOBODY),  # slow, and fast
]


@pytest.mark.parametrize(("way_s", "dead"), STANDING)
def test_one_that_stands_while_another_drives_is_dead_and_lost(way_s, dead):
    losses = driven(way_s)
    assert losses.dead.tolist() == dead
    assert losses.lost.tolist() == dead
    assert losses.loss_counts.tolist() == [int(is_dead) for is_dead in dead]


@pytest.mark.parametrize(
    ("wheels", "rule"), [(True, LossRule(0.3, False, True, True)), (False, None)]
)
def test_unless_a_spec_says_otherwise_one_on_wheels_that_is_dead_ends_the_trial(wheels, rule):
    stated = {"wheels": {"radius": 40}} if wheels else {}
    assert experiment(**stated).setup.loss == rule


@pytest.mark.long
def test_a_trial_goes_on_without_a_robot_that_does_not_move(tmp_path):
    """Blue sticks for good after 4 s: the others reach their targets without it."""
    sticking = "plant.disturbances=[{type: sticking, every: 20, duration: 100}]"
    settings = [sticking, "trials.seed=2", "on_lost=drop"]
    result = run_logged(load_spec(ROOT / "experiments/three_m3pi.yaml", settings), tmp_path)
    path = log_path(tmp_path, 0)
    log = read_trial(path)
    assert result.lost == log.route.lost == (0, 1, 0)
    assert max(result.robot_errors[0], result.robot_errors[2]) < 10
    said = "blue does not move while others drive: the trial goes on without them"
    assert said in [note.text for note in log.notes]
    assert verify(path).problems == ()


@pytest.mark.long
@pytest.mark.parametrize(("robots", "on_lost"), [(LISTED, "drop"), (MARKED, "replace")])
def test_a_trial_goes_on_counts_who_was_lost_and_can_be_verified(
    robots, on_lost, tmp_path, monkeypatch
):
    install(monkeypatch)
    spec = parse_spec(REST + robots + f"on_lost: {on_lost}\n", "three.yaml")
    result = run_logged(spec, tmp_path)
    path = log_path(tmp_path, 0)
    log = read_trial(path)
    assert sum(result.lost) > 0
    assert read_result(path).result.lost == result.lost
    assert log.route.lost == result.lost
    paths = [step.plan.path for step in log.steps]
    assert all(path.shape[1:] == (3, 3) for path in paths)
    still = np.array([np.ptp(path[:, :, 0], axis=0) == 0 for path in paths])
    tracked = [i for i, gone in enumerate(result.lost) if not gone]
    assert still.any()  # who is lost is planned to stay where it was
    assert not still[:, tracked].any()
    assert max(np.array(result.robot_errors)[tracked], default=0) < 100
    assert verify(path).problems == ()
    contents = scan(path)
    (place,) = (i for i, entry in enumerate(contents.entries) if entry.topic == RESULT)
    forged = with_entry(contents, tmp_path / "forged.mcap", place, ("lost", 0))
    assert [problem.field for problem in verify(forged).problems] == ["/result[0].lost.0"]
    assert LOST.of_trial(read_result(path)) == {"lost": sum(result.lost)}
    assert any("lost" in note for note in trial_notes(read_result(path)))


def test_a_robot_of_a_list_cannot_be_replaced():
    with pytest.raises(SpecError, match="on_lost"):
        parse_spec(REST + LISTED + "on_lost: replace\n", "three.yaml")
