"""Tests of the checks before robots move, with a fake camera and actuator in virtual time."""

import math
from dataclasses import replace

import pytest
from testkit.labs import fake_lab
from testkit.trials import experiment

from tetractl.core.errors import AbortError
from tetractl.core.poses import Pose
from tetractl.core.protocols import RobotStatus
from tetractl.lab.preflight import inspect, look_over


def looked_over(change=lambda camera: None):
    """The preflight of a lab after its camera has changed."""
    lab = fake_lab(experiment().setup)
    with lab.plant.rig as rig:
        change(lab.camera)
        return inspect(rig)


def test_a_good_lab_has_no_problem():
    assert looked_over().problems == ()


def test_each_device_is_checked_once(monkeypatch):
    """Regression: whether devices are emulated was asked by a second check, of 0.7 s in a dish."""
    lab = fake_lab(experiment().setup)
    checked = []

    def watch(name):
        device = getattr(lab, name)
        check = device.check

        def counted():
            checked.append(name)
            return check()

        monkeypatch.setattr(device, "check", counted)

    watch("camera")
    watch("actuator")
    with lab.plant.rig as rig:
        inspect(rig)
    assert sorted(checked) == ["actuator", "camera"]


class Missing:
    """A device that cannot be opened."""

    def __init__(self, device, what):
        self.device = device
        self.what = what

    def __enter__(self):
        raise AbortError(f"there is no {self.what}", f"plug in the {self.what}")

    def __exit__(self, *_):
        pass

    def __getattr__(self, name):
        return getattr(self.device, name)


@pytest.mark.parametrize("missing", [["camera"], ["actuator"], ["actuator", "camera"]])
def test_all_missing_devices_are_problems_beside_those_of_the_others(missing):
    """Regression: the first device that was missing was the only one that was named."""
    lab = fake_lab(experiment().setup)
    rig = lab.plant.rig
    rig.camera.hidden.add(rig.setup.names[1])
    rig.actuator.poll = lambda timeout_s: [RobotStatus(False)] * 3
    for what in missing:
        setattr(rig, what, Missing(getattr(rig, what), what))
    report = look_over(rig)
    assert report.problems == tuple(f"there is no {what} (plug in the {what})" for what in missing)
    answers = [robot.status.answers for robot in report.robots]
    assert answers == [None if "actuator" in missing else False] * 3
    tracked = [robot.tracked for robot in report.robots]
    assert tracked == [missing == ["actuator"] and i != 1 for i in range(3)]
    assert not report.can_start


def test_a_camera_whose_frames_are_all_dropped_is_a_problem_with_a_reason():
    """Regression: all of the frames watched were dropped, and nothing was wrong."""

    def outdate(camera):
        frames = camera.frames

        def older():
            return [replace(frame, sampled_ns=0) for frame in frames()]

        camera.frames = older

    report = looked_over(outdate)
    assert not report.can_start
    (problem,) = report.problems
    assert problem.startswith("no new camera frame for 0.")
    assert "outdated frames came" in problem


def test_a_silent_camera_is_a_problem():
    def silence(camera):
        camera.silent = True

    (problem,) = looked_over(silence).problems
    assert problem.startswith("no new camera frame for 0.5")


@pytest.mark.parametrize(
    ("age_ms", "said"), [(90, ()), (110, ("frames are 110 ms old on arrival",))]
)
def test_frames_that_are_old_on_arrival_are_a_problem(age_ms, said, monkeypatch):
    monkeypatch.setattr("testkit.labs.LATENCY_NS", age_ms * 1_000_000)
    assert looked_over().problems == said


@pytest.mark.parametrize("x", [1000.0, -5000.0])
def test_what_is_no_robot_must_not_stand_in_the_arena(x):
    def place(camera):
        frames = camera.frames
        camera.frames = lambda: [
            replace(frame, unknown_objects=(Pose(x, 700.0, 0.0),)) for frame in frames()
        ]

    inside = ("something else stands in the arena at 1000, 700 mm",)
    assert looked_over(place).problems == (inside if x > 0 else ())


def turn(*angles):
    """Let the camera show each robot turned by an angle [rad]."""

    def change(camera):
        frames = camera.frames

        def turned():
            for frame in frames():
                poses = [
                    Pose(p.x, p.y, p.heading + angle)
                    for p, angle in zip(frame.poses, angles, strict=True)
                ]
                yield replace(frame, poses=tuple(poses))

        camera.frames = lambda: list(turned())

    return change


@pytest.mark.parametrize(("quarters", "degrees"), [(-1, "-90"), (1, "+90"), (2, "180")])
def test_tags_that_are_all_turned_by_quarters_are_noticed(quarters, degrees):
    """Regression: tags glued on with the top edge forward, as the guide was understood."""
    turned = quarters * math.pi / 2
    report = looked_over(turn(turned + 0.1, turned - 0.1, turned))
    assert not report.can_start
    (warning,) = report.warnings
    assert warning.startswith(f"all robots are turned by {degrees} degrees from the start heading")


@pytest.mark.parametrize("turned", [(0.1, -0.1, 0.0), (1.57, 1.57, 0.0), (1.57, -1.57, 1.57)])
def test_robots_that_are_turned_otherwise_have_no_turned_tags(turned):
    assert looked_over(turn(*turned)).warnings == ()


def test_robots_that_may_start_at_any_heading_have_no_turned_tags():
    """Regression: a trial that finds its cells in a dish was refused, as all three happened to swim
    the other way."""
    lab = fake_lab(experiment().setup)
    with lab.plant.rig as rig:
        rig.start_anywhere()
        turn(*[math.pi] * 3)(lab.camera)
        report = inspect(rig)
    assert (report.warnings, report.can_start) == ((), True)


def test_a_run_names_all_devices_that_are_missing():
    lab = fake_lab(experiment().setup)
    rig = lab.plant.rig
    rig.actuator = Missing(rig.actuator, "actuator")
    rig.camera = Missing(rig.camera, "camera")
    with pytest.raises(AbortError) as caught, rig:
        pass
    assert caught.value.message == "there is no actuator; there is no camera"
    assert caught.value.hint == "plug in the actuator; plug in the camera"


def test_a_rig_that_was_closed_stays_closed():
    rig = fake_lab(experiment().setup).plant.rig
    with rig:
        pass
    rig.camera = Missing(rig.camera, "camera")
    rig.open()  # AbortError if it opened the camera


def test_a_camera_whose_program_ends_meanwhile_is_the_problem():
    """Regression: its frames were reported as missing."""

    def end(camera):
        camera.silent = True
        camera.frames = gone

    def gone():
        raise AbortError("the program of the camera has ended")

    assert looked_over(end).problems == ("the program of the camera has ended",)
