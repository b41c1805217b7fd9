"""Tests that a trial steered by hand equals the trial of `sequence` with the same directions."""

import math

import numpy as np
import pytest

import tetractl
from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.commands import Stop
from tetractl.core.plan import Outcome
from tetractl.core.protocols import Observer
from tetractl.log.read.find import find_logs
from tetractl.log.read.reader import content_digest
from tetractl.run.hand import HandController, WallPace, run_by_hand
from tetractl.run.interrupt import Interrupt
from tetractl.run.open_trial import directed_spec
from tetractl.spec.load import parse_contents

CONTENTS = {
    "name": "by-hand",
    "arena": {"left": 0, "bottom": 0, "width": 1000, "height": 1000},
    "robots": [
        {"name": "a", "start": [200, 500], "target": [500, 500], "a": 3, "speed": 100},
        {"name": "b", "start": [200, 300], "target": [500, 300], "a": 2, "speed": 100},
    ],
    "wheels": {"radius": 40},
    "controller": {"type": "mpc", "time_limit": 20, "dead_time": 0.1},
    "plant": {
        "type": "sim",
        "dead_time": 0.1,
        "heading_noise": 0.05,
        "measurement_noise": {"position": 1, "heading": 0.02},
    },
    "trials": {"count": 3, "seed": 5},
}
SPEC = parse_contents(CONTENTS, "by-hand.yaml")


def steer(spec, folder, ask, interrupt=None, observers=()):
    """Run trial 1 of a spec by hand, and return its log, its result and its controller."""
    directed = directed_spec(spec)
    hand = HandController(directed, 1, ask)
    result = run_by_hand(directed, folder, hand, observers, interrupt)
    return folder / "trial-001.mcap", result, hand


def chosen(directions):
    """Return what asks for these directions, one after the other, and then stops."""
    following = iter(directions)
    return lambda time_s: next(following, None)


@pytest.mark.parametrize("number", range(10))
def test_its_log_is_that_of_the_same_directions_by_open_trial(number, tmp_path):
    random = np.random.default_rng(number)
    directions = random.uniform(-math.pi, math.pi, 8 + number).tolist()
    log, result, _ = steer(SPEC, tmp_path / "hand", chosen(directions))
    assert result.outcome is Outcome.SEQUENCE_COMPLETED

    trial = tetractl.open_trial(SPEC, trial=1)
    for direction in directions:
        trial.step(direction)
    trial.stop()
    stepped = trial.save(tmp_path / "stepped")
    assert content_digest(log) == content_digest(stepped)
    assert not tetractl.verify(log).problems


def test_a_plan_is_shown_of_a_direction_that_is_not_sent(tmp_path):
    directed = directed_spec(SPEC)
    tried = []
    hand = HandController(
        directed, 1, chosen([0.5]), lambda plan_of: tried.append(plan_of(1.0).path)
    )
    run_by_hand(directed, tmp_path, hand)
    assert hand.directions == [0.5]
    assert len(tried) == 2  # before the direction, and before the end
    assert (tried[0][-1, :, 1] > tried[0][0, :, 1]).all()  # 1 rad leads up


def test_an_interruption_ends_it_and_its_log_is_whole(tmp_path):
    interrupt = Interrupt()

    def ask(time_s):
        if time_s > 0.2:
            interrupt.request()
        return 1.0

    log, result, hand = steer(SPEC, tmp_path, ask, interrupt)
    assert result.outcome is Outcome.INTERRUPTED
    verified = tetractl.verify(log)
    assert not verified.problems
    saved = tetractl.read_log(log)
    assert [step.plan.direction for step in saved.steps] == hand.directions == [1.0] * 6
    assert isinstance(saved.commands[-1].action, Stop)


def test_while_it_runs_a_plan_shows_where_robots_go_if_the_direction_is_held(tmp_path):
    shown = []

    class Watch(Observer):
        def on_step(self, step):
            shown.append(step.plan)

    log, _, _ = steer(SPEC, tmp_path, chosen([0.0, 2.0]), observers=[Watch()])
    assert [plan.signals.tolist() for plan in shown] == [[0.0] * 50, [2.0] * 50]
    logged = tetractl.read_log(log).steps
    assert [step.plan.signals.tolist() for step in logged] == [[0.0, 2.0], [2.0]]


def test_a_crash_leaves_the_log_so_far(tmp_path):
    """Regression: a log by hand was written at its end, and a killed process had none."""
    directions = iter([0.5, 1.0, 1.5])
    with pytest.raises(StopIteration):
        steer(SPEC, tmp_path, lambda time_s: next(directions))
    left = tetractl.read_log(tmp_path / "trial-001.mcap.part")
    assert [step.plan.direction for step in left.steps] == [0.5, 1.0, 1.5]
    assert len(left.mocap) > 3


class Killed(BaseException):
    """Stands for the end of the process at some point."""


def killed(*args, **options):
    raise Killed


@pytest.mark.parametrize(
    ("where", "name"),
    [
        ("tetractl.run.hand.HandLog.save", "trial-001.mcap.part"),
        ("tetractl.run.hand.HandController.plan_of_sequence", "trial-001.mcap.part"),
        ("pathlib.Path.unlink", "trial-001.mcap"),
    ],
)
def test_a_kill_while_the_log_is_finished_leaves_one_log(where, name, tmp_path, monkeypatch):
    """Regression: a whole log that failed `verify`, or two logs of one trial."""
    monkeypatch.setattr(where, killed)
    with pytest.raises(Killed):
        steer(SPEC, tmp_path, chosen([0.5, 1.0, 1.5]))
    (left,) = find_logs([tmp_path])
    assert left.name == name
    assert len(tetractl.read_batch(tmp_path).trials) == 1
    if name.endswith(".mcap"):
        assert tetractl.verify(left).ok


@pytest.mark.parametrize("speed", [0.5, 2.0])
def test_the_wall_pace_makes_every_trial_last_as_long_as_people_need(speed, tmp_path):
    """Also the second trial, whose times begin at 0 again."""
    wall = VirtualClock()
    pace = WallPace(wall, speed)
    directions = [0.0] * 11
    for number in (1, 2):
        began_ns = wall.now()
        steer(SPEC, tmp_path / f"{speed}-{number}", chosen(directions), observers=[pace])
        steps_s = 10 * 0.05
        assert (wall.now() - began_ns) / SECOND == pytest.approx(steps_s / speed)


def test_a_step_is_asked_for_by_its_time(tmp_path):
    asked = []

    def ask(time_s):
        asked.append(time_s)
        return 0.5 if len(asked) < 4 else None

    steer(SPEC, tmp_path, ask)
    assert asked == pytest.approx([0.0, 0.05, 0.10, 0.15])


def test_no_direction_leaves_no_log(tmp_path):
    steer(SPEC, tmp_path / "hand", chosen([]))
    assert not (tmp_path / "hand").exists()
