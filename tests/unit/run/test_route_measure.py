"""Tests of way-points and a hold, for robots on wheels that stand and for cells that circle."""

from dataclasses import replace

import numpy as np
import pytest
from testkit.mutate import with_entry

from tetractl.core.errors import SpecError
from tetractl.core.plan import Outcome
from tetractl.core.poses import Observation, Poses, Sample
from tetractl.core.route_measure import HoldTask, RouteMeasure
from tetractl.log.format.channels import RESULT
from tetractl.log.read.reader import read_result, read_trial
from tetractl.log.read.salvage import scan
from tetractl.run.logged_trial import log_path, run_logged
from tetractl.spec.load import parse_spec
from tetractl.statistics.built_in_statistics import TIME_INSIDE
from tetractl.verification.verify import verify

MPC = """{type: mpc, period: 0.2, horizon_max: 30, time_limit: 40.2, accept_error: 20,
  estimate: false, optimizer: {type: multistart, tolerance: 1}}"""
ONE = f"""
name: one
arena: {{left: 0, bottom: 0, width: 3000, height: 3000}}
robots: [{{name: one, start: [500, 500], via: [[900, 700]], target: [1500, 600], a: 5, speed: 300}}]
hold: {{radius: 100, time: 6}}
controller: {MPC}
plant: {{type: sim, camera_rate: 30, heading_noise: 0.05}}
"""


@pytest.mark.parametrize(
    ("wheels", "least"),
    [pytest.param("", 0.9, marks=pytest.mark.long), ("wheels: {radius: 40}", 0.99)],
)
def test_robots_pass_way_points_and_stay_circling_or_standing(wheels, least, tmp_path):
    spec = parse_spec(ONE + wheels, "one.yaml")
    result = run_logged(spec, tmp_path)
    path = log_path(tmp_path, 0)
    log = read_trial(path)
    assert result.outcome.complete
    assert len(result.passed) == 1
    assert result.passed[0] < 40  # half the way of a control period is 30
    assert result.inside[0] >= least
    legs = [step.plan.leg for step in log.steps]
    assert legs == sorted(legs)
    assert set(legs) == {0, 1, 2}
    held = [step for step in log.steps if step.plan.leg == 2]
    pauses = [step.plan.pauses for step in held]
    assert all(pauses) if wheels else not any(pauses)
    lasted = log.stop.sent_ns - held[0].observation.sampled_ns
    assert 6 <= lasted / 1e9 < 7
    assert [note.text for note in log.notes if "way-point" in note.text or "hold" in note.text] == [
        "way-point 1 of 1 is passed",
        "the robots have arrived and hold",
    ]
    summary = read_result(path)
    cut = replace(summary, result=replace(result, outcome=Outcome.INTERRUPTED))
    assert TIME_INSIDE.of_trial(summary) == {"inside_one": result.inside[0]}
    assert TIME_INSIDE.of_trial(cut) == {"inside_one": None}
    assert verify(path).problems == ()
    contents = scan(path)
    (place,) = (i for i, entry in enumerate(contents.entries) if entry.topic == RESULT)
    for field in ("inside", "passed"):
        forged = with_entry(contents, tmp_path / f"{field}.mcap", place, (field, 0))
        assert [problem.field for problem in verify(forged).problems] == [f"/result[0].{field}.0"]


def test_the_time_inside_is_the_share_of_the_frames_of_the_hold_in_which_a_robot_is_near():
    """One robot, at x of each frame and y = 0, is to pass (5, 0) and then to hold within 1 mm of
    (0, 0). It passes at x = 4. The hold is frames 3 to 6: it is near in 3 and, in truth, in 6, but
    too far in 4, and in 5 not tracked, which counts as outside."""

    def at(x):
        return Poses.from_array(np.array([[x, 0.0, 0.0]]))

    def frame(number, x, valid=True, true_x=None):
        observation = Observation(number, number, number, at(x), np.array([valid]))
        return Sample(observation, None if true_x is None else at(true_x))

    legs = np.array([[[5.0, 0.0]], [[0.0, 0.0]]])
    measure = RouteMeasure(legs, HoldTask(1.0, 9.0), None, np.ones(1))
    measure.record_step(0, frame(0, 9.0).observation)
    measure.add_samples([frame(1, 0.0)])
    measure.record_step(1, frame(2, 4.0).observation)
    assert measure.inside == ()
    measure.record_step(2, frame(3, 0.0).observation)
    measure.add_samples([frame(2, 0.0), frame(3, 0.0)])
    measure.add_samples([frame(4, 3.0), frame(5, 0.0, valid=False)])
    measure.add_samples([frame(6, 9.0, true_x=0.5), frame(7, 0.0)], until_ns=6)
    assert measure.passed == (1.0,)
    assert measure.inside == (2 / 4,)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("via: [[900, 700]]", "via: [[900, 7000]]", "robots.0.via.0: [900, 7000]: is outside"),
        (", a: 5, speed: 300}", ", a: 5, speed: 300}, {name: b, start: [1, 1], target: [2, 2], "
         "a: 4, speed: 9}", "have 0 and 1 way-points in via"),
        (MPC, "{type: sequence, directions: [0]}", "supports neither way-points"),
        ("time: 6", "time: 0", "hold.time"),
    ],
)  # fmt: skip
def test_a_tour_that_cannot_be_is_refused(old, new, said):
    with pytest.raises(SpecError) as raised:
        parse_spec(ONE.replace(old, new), "one.yaml")
    assert said in str(raised.value)
