"""Tests that a trial stepped by a script equals the trial of `sequence` with its directions."""

import gc
import math

import numpy as np
import pytest
import yaml
from testkit.paths import ROOT

import tetractl
from tetractl.core.errors import SpecError, UsageError
from tetractl.core.plan import Outcome
from tetractl.core.poses import Observation, Poses, Sample
from tetractl.log.read.reader import content_digest
from tetractl.run.logged_trial import run_logged
from tetractl.run.open_trial import DroppedError, OpenTrial, TruthWatch
from tetractl.spec.examples import find_examples
from tetractl.spec.load import parse_spec
from tetractl.spec.plants import select_plant

SPEC = {
    "name": "stepped",
    "arena": {"left": 0, "bottom": 0, "width": 1000, "height": 1000},
    "robots": [
        {"name": "a", "start": [200, 500], "target": [500, 500], "a": 3, "speed": 100},
        {"name": "b", "start": [200, 300], "target": [500, 300], "a": 2, "speed": 100},
    ],
    "controller": {"type": "mpc", "time_limit": 20},
    "plant": {"type": "sim", "measurement_noise": {"position": 1, "heading": 0.02}},
    "trials": {"count": 3, "seed": 5},
}


REFUSED = {
    "magnetospirillum_hold": "neither way-points nor a hold",
    "microjet_hold": "neither way-points nor a hold",
    "tetrahymena_hold": "neither way-points nor a hold",
    "tetrahymena_dish": "a trial of this spec chooses its robots",
}
"""The shipped specs that `sequence` cannot run, and why."""
SHIPPED = {
    name: file
    for name, file in find_examples().items()
    if not name.startswith(("faults/", "studies/"))  # scripts of the emulated lab, and studies
}


def drive(trial: OpenTrial, steps: int, direction: float = 0.1) -> None:
    """Step a trial, at most so often, until it has a result."""
    for _ in range(steps):
        if trial.result is None:
            trial.step(direction)


def saved(trial, steps, folder):
    """The log of a trial that is stepped in random directions; it is that of a run of its spec."""
    random = np.random.default_rng(1)
    for _ in range(steps):
        trial.step(random.uniform(-math.pi, math.pi))
    if trial.result is None:
        trial.stop()
    log = trial.save(folder / "stepped")
    (folder / "run").mkdir()
    spec = parse_spec(trial.spec.text, trial.spec.name)
    run_logged(spec, folder / "run", int(log.stem.removeprefix("trial-")))
    assert content_digest(log) == content_digest(folder / "run" / log.name)
    assert not tetractl.verify(log).problems
    return log


def test_its_log_is_that_of_a_run_of_its_spec(tmp_path):
    trial = tetractl.open_trial(SPEC, trial=2)
    log = saved(trial, 12, tmp_path)
    assert log.name == "trial-002.mcap"
    sent = [step.plan.direction for step in tetractl.read_log(log).steps]
    assert sent == list(trial.directions)


@pytest.mark.long
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.release if name.startswith("benchmark/") else ())
        for name in SHIPPED
        if name not in REFUSED
    ],
)
def test_the_log_of_each_shipped_spec_is_that_of_a_run(name, tmp_path):
    saved(tetractl.open_trial(SHIPPED[name], trial=1), 30, tmp_path)


@pytest.mark.parametrize("name", [name for name in REFUSED if name in SHIPPED])
def test_a_shipped_spec_that_a_sequence_cannot_run_is_refused_with_its_reason(name):
    with pytest.raises(UsageError, match=REFUSED[name]):
        tetractl.open_trial(SHIPPED[name])


def test_it_ends_when_each_robot_is_within_the_tolerance_of_the_spec():
    within = SPEC["controller"] | {"arrival_tolerance": 15}
    trial = tetractl.open_trial(SPEC | {"controller": within})
    drive(trial, 100, direction=0.0)  # straight on: both targets are 300 mm ahead
    assert trial.result.outcome is Outcome.ARRIVED
    assert max(trial.result.robot_errors) < 15 + 5  # 5 mm are driven in a control period


def test_it_ends_at_the_limit_of_time():
    trial = tetractl.open_trial(SPEC | {"controller": {"type": "mpc", "time_limit": 1.0}})
    drive(trial, 100, direction=1.5)
    assert trial.result.outcome is Outcome.TIME_LIMIT
    assert len(trial.directions) == 20  # of 0.05 s


def test_a_robot_that_drives_through_an_obstacle_between_two_frames_has_failed():
    thin = {"type": "circle", "center": [301.5, 500], "radius": 0.5}  # frames show 300 and 303.3
    plant = {"type": "sim", "camera_rate": 30}
    trial = tetractl.open_trial(SPEC | {"obstacles": [thin], "plant": plant})
    drive(trial, 18, direction=0.0)  # of 5 mm: to 290
    assert not trial.failed
    drive(trial, 4, direction=0.0)
    assert trial.failed


@pytest.mark.parametrize("direction", [math.nan, "east", None, [1.0, 2.0]], ids=repr)
def test_a_wrong_direction_is_not_sent(direction):
    trial = tetractl.open_trial(SPEC)
    with pytest.raises(UsageError, match="must be a finite number"):
        trial.step(direction)
    assert trial.directions == ()


def test_an_ended_trial_is_neither_stepped_nor_stopped(tmp_path):
    trial = tetractl.open_trial(SPEC)
    with pytest.raises(UsageError, match="at least one direction"):
        trial.stop()
    drive(trial, 1)
    with pytest.raises(UsageError, match="has not ended"):
        trial.save(tmp_path)
    trial.stop()
    with pytest.raises(UsageError, match="the trial has already ended: sequence completed"):
        trial.step(0.0)
    with pytest.raises(UsageError, match="the trial has already ended"):
        trial.stop()
    with pytest.raises(
        UsageError, match="the folder must be a path, but the value given is of type int"
    ):
        trial.save(3)
    trial.save(tmp_path)
    with pytest.raises(UsageError, match="exists already"):
        trial.save(tmp_path)


def test_what_a_sequence_cannot_do_is_refused():
    with pytest.raises(SpecError, match="sequence supports neither way-points nor a hold"):
        tetractl.open_trial(SPEC | {"hold": {"radius": 20, "time": 5}})


def test_a_lab_is_refused():
    lab = tetractl.load_spec(ROOT / "experiments" / "three_m3pi_lab.yaml")
    with pytest.raises(UsageError, match="plant is the lab"):
        tetractl.open_trial(select_plant(lab, "lab"))


def test_its_spec_is_text_that_gives_the_same_trial(tmp_path):
    trial = tetractl.open_trial(SPEC, seed=77)
    drive(trial, 5)
    result = trial.stop()
    again = tetractl.run_trial(tetractl.parse_spec(trial.spec.text))
    assert again.start.seed == 77
    assert again.result.robot_errors == result.robot_errors


def test_an_error_that_mpc_accepts_is_no_arrival():
    trial = tetractl.open_trial(SPEC | {"controller": {"type": "mpc", "accept_error": 500}})
    drive(trial, 70, direction=0.0)  # by 5 mm, so past both targets
    assert trial.result is None


def test_a_robot_outside_the_arena_has_failed():
    trial = tetractl.open_trial(SPEC)
    assert not trial.failed
    drive(trial, 100, direction=3.0)  # 5 s at 100 mm/s, and the left edge is at 200 mm
    assert trial.failed


def test_its_first_observation_is_at_the_starts():
    trial = tetractl.open_trial(SPEC | {"plant": {"type": "sim"}})
    np.testing.assert_allclose(trial.observation.poses.xy, [[200, 500], [200, 300]])
    with pytest.raises(ValueError, match="read-only"):
        trial.observation.poses.x[0] = 0.0


def test_a_dropped_trial_says_nothing(capsys):
    trial = tetractl.open_trial(SPEC)
    drive(trial, 2)
    asked = trial._controller.messages_to_script
    del trial
    gc.collect()
    assert isinstance(asked.get(timeout=60), DroppedError)  # its robots stand, its thread has ended
    assert capsys.readouterr() == ("", "")


def test_a_trial_that_is_broken_off_has_ended():
    trial = tetractl.open_trial(SPEC)
    trial.step(0.1)
    # as if Ctrl-C came amid the next step
    trial._controller.messages_to_script.put(KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        trial.step(0.1)
    with pytest.raises(UsageError, match="cut short"):
        trial.step(0.1)


def test_a_spec_is_taken_as_a_file_too(tmp_path):
    path = tmp_path / "spec.yaml"
    path.write_text(yaml.safe_dump(SPEC))
    assert tetractl.open_trial(path).setup.names == ("a", "b")


# ---- Failing, frame by frame ----


def watch_of(thin=(301.5, 500.0), radius=0.5):
    obstacle = {"type": "circle", "center": list(thin), "radius": radius}
    setup = tetractl.parse_spec(SPEC | {"obstacles": [obstacle]}).experiment.setup
    return TruthWatch(setup)


def frame(ax, ay, bx=500.0, by=300.0):
    poses = Poses(np.array([ax, bx]), np.array([ay, by]), np.zeros(2))
    return Sample(Observation(0, 0, 0, poses, np.ones(2, bool)), poses)


@pytest.mark.parametrize("apart", [True, False])
def test_a_line_between_two_frames_is_checked_whether_they_come_together_or_not(apart):
    frames = [frame(300.0, 500.0), frame(303.3, 500.0)]
    watch = watch_of()
    for part in [[f] for f in frames] if apart else [frames]:
        assert not watch.failed
        watch.on_samples(part)
    assert watch.failed


def test_the_first_frame_has_no_line_before_it_and_frames_beside_an_obstacle_are_none():
    watch = watch_of()
    watch.on_samples([frame(303.3, 500.0)])
    watch.on_samples([frame(310.0, 500.0), frame(310.0, 400.0), frame(290.0, 400.0)])
    assert not watch.failed


@pytest.mark.parametrize("robot", [0, 1])
@pytest.mark.parametrize(
    ("x", "y", "failed"),
    [
        *((x, 500.0, x in (-0.1, 1000.1)) for x in (-0.1, 0.0, 1000.0, 1000.1)),
        *((500.0, y, y in (-0.1, 1000.1)) for y in (-0.1, 0.0, 1000.0, 1000.1)),
    ],
)
def test_either_robot_fails_beyond_any_edge_and_not_on_it(robot, x, y, failed):
    watch = watch_of(thin=(100.0, 100.0))
    watch.on_samples([frame(x, y) if robot == 0 else frame(700.0, 500.0, x, y)])
    assert watch.failed == failed


def test_who_has_failed_once_stays_failed_and_measured_poses_alone_say_nothing():
    watch = watch_of(thin=(100.0, 100.0))
    outside = frame(-50.0, 500.0)
    watch.on_samples([Sample(outside.observation, None)])
    watch.on_samples([])
    assert not watch.failed
    watch.on_samples([outside])
    watch.on_samples([frame(500.0, 500.0)])
    assert watch.failed
