"""Tests of what `verify` notices in the log of a lab in which one value was changed.

`verify` computes the decisions in a lab's log again from the logged frames, and compares the
errors, the final poses and the entered obstacles with them. Only digests protect everything else,
and these tests make the digests fit.
"""

from dataclasses import replace

import pytest
from testkit.emulator.lab_logs import lab_log
from testkit.tampering import score

from tetractl.log.format import channels
from tetractl.log.read.reader import read_trial
from tetractl.verification.result_check import result_differences
from tetractl.verification.verify import verify

pytestmark = pytest.mark.system

OBSERVED = ("sampled_ns", "x", "y", "heading", "valid")
SEARCHED = ("length", "signals", "cost", "history", "evaluations", "stopped")
ESTIMATED = (
    *("a", "a_std", "speed", "speed_std", "heading_bias", "heading_bias_std"),
    *("dead_time", "dead_time_std", "misfit", "side", "side_std", "saturation", "stands"),
    *("lag", "lag_std"),
)
DECIDED = {
    *((channels.STEP, f"observation.{field}") for field in OBSERVED),
    *((channels.STEP, f"searches.{field}") for field in SEARCHED),
    *((channels.STEP, f"estimate.{field}") for field in ESTIMATED),
    *((channels.STEP, field) for field in ("-", "x2", "k", "signals", "cost", "target_cost")),
    *((channels.STEP, field) for field in ("path_x", "path_y", "state", "generator")),
    (channels.STEP, "command.direction"),
    (channels.STEP, "command.lag"),
    (channels.STEP, "command.sent_ns"),
}
RESULTS = ("-", "outcome", "unit", "steps", "total_error", "robot_errors", "entered")
ENDED = {
    *((channels.RESULT, field) for field in (*RESULTS, "final_x", "final_y", "final_heading")),
}
SMALL = (  # 5 Hz, few steps and a small swarm
    "controller.time_limit=1",
    "controller.period=0.2",
    "controller.signal_periods=1",
    "controller.deadline=0.15",
    "controller.optimizer={type: pso, particles: 6, iterations: 14}",
)


def decides(record, what):
    """Whether a robot was tracked in the first step decides nothing: it is placed at its pose."""
    if what != "observation.valid":
        return True
    return channels.CHANNELS[channels.STEP].FromString(record.data).k > 0


def test_a_changed_turn_of_a_lab_is_noticed(tmp_path):
    """Regression: any rate at which robots turn by themselves was accepted, and `stats` flags
    trials by it."""
    log = read_trial(lab_log(tmp_path, ("controller.time_limit=3", *SMALL[1:])))
    verdict = log.result.verdict
    assert list(result_differences(log, log.result)) == []
    robots = len(verdict.turn)
    assert robots
    for changes, field in [
        ({"turn": (5.0,) * robots}, "result.turn.0"),
        ({"turn_std": (1e-6,) * robots}, "result.turn_std.0"),
        ({"turn_std": (-1.0,) * robots}, "result.turn_std.0"),
        ({"turn": (), "turn_std": ()}, "result.turn"),
    ]:
        changed = replace(log.result, verdict=replace(verdict, **changes))
        fields = [difference.field for difference in result_differences(log, changed)]
        assert field in fields, changes


def test_a_changed_decision_error_or_final_pose_of_a_lab_is_noticed(tmp_path):
    path = lab_log(tmp_path, SMALL)
    assert verify(path).problems == ()
    noticed, tried = score(path, 1, DECIDED | ENDED, decides)
    assert tried.keys() == DECIDED | ENDED
    assert {kind for kind in tried if noticed[kind] < tried[kind]} == set()
