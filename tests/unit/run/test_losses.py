"""Robots that are lost: the trial ends, goes on without them, or with others in their places."""

import numpy as np
import pytest
from support.mutate import with_entry

from tetractl.core.errors import SpecError
from tetractl.core.poses import Observation, Poses
from tetractl.core.tour import Losses, LossRule
from tetractl.experiment.load import parse_spec
from tetractl.log.format.channels import RESULT
from tetractl.log.read.reader import read_result, read_trial
from tetractl.log.read.salvage import scan
from tetractl.replay.verify import verify
from tetractl.results.describe import _notes
from tetractl.results.outcomes import LOST
from tetractl.run.task import log_path, run_trial

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
CHOSEN = "robots: {choose: 3, ring: {center: [1500, 1500], radius: 500}, a: 4, speed: 420}\n"

ROUND = "obstacles: [{type: circle, center: [1500, 1500], radius: 100}]\n"


def seen(t, *valid):
    poses = Poses.of(np.zeros((len(valid), 3)))
    return Observation(0, round(t * 1e9), round(t * 1e9), poses, np.array(valid, dtype=bool))


@pytest.mark.parametrize(
    ("rule", "lost", "times", "others"),
    [
        (None, [0, 0], [0, 0], []),
        (LossRule(0.3, False), [1, 0], [1, 0], []),
        (LossRule(0.3, True), [0, 0], [1, 0], [(0.5, 0)]),
    ],
)
def test_a_robot_is_lost_after_a_while_for_good_or_until_another_is_there(
    rule, lost, times, others
):
    losses = Losses(rule, 2)
    rows = [(0.0, 0, 1), (0.2, 1, 1), (0.4, 0, 0), (0.49, 0, 1), (0.5, 1, 1), (0.6, 1, 1)]
    back = [(t, i) for t, *valid in rows for i in losses.see(seen(t, *valid))]
    assert back == others
    assert losses.lost.tolist() == list(map(bool, lost))
    assert losses.times.tolist() == times


@pytest.mark.parametrize(("robots", "on_lost"), [(LISTED, "drop"), (CHOSEN, "replace")])
def test_a_trial_goes_on_counts_who_was_lost_and_can_be_verified(robots, on_lost, tmp_path):
    spec = parse_spec(REST + robots + f"on_lost: {on_lost}\n", "three.yaml")
    result = run_trial(spec, tmp_path)
    path = log_path(tmp_path, 0)
    log = read_trial(path)
    assert sum(result.lost) > 0
    assert read_result(path).result.lost == result.lost
    assert log.tour.lost == result.lost
    paths = [step.plan.path for step in log.steps]
    assert all(path.shape[1:] == (3, 3) for path in paths)
    still = np.array([np.ptp(path[:, :, 0], axis=0) == 0 for path in paths])
    known = [i for i, gone in enumerate(result.lost) if not gone]
    assert still.any()  # who is lost is planned to stay where it was
    assert not still[:, known].any()
    assert max(np.array(result.robot_errors)[known], default=0) < 100
    assert verify(path).problems == ()
    contents = scan(path)
    (at,) = (i for i, entry in enumerate(contents.entries) if entry.topic == RESULT)
    forged = with_entry(contents, tmp_path / "forged.mcap", at, ("lost", 0))
    assert [one.field for one in verify(forged).problems] == ["/result[0].lost.0"]
    assert LOST.of_trial(read_result(path)) == {"lost": sum(result.lost)}
    assert any("lost" in note for note in _notes(read_result(path)))


@pytest.mark.parametrize("robots", [LISTED, CHOSEN + ROUND])
def test_only_one_cell_among_others_can_be_replaced(robots):
    with pytest.raises(SpecError, match="on_lost"):
        parse_spec(REST + robots + "on_lost: replace\n", "three.yaml")
