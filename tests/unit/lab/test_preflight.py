"""What is checked before robots move, in virtual time, of a fake camera and a fake actuator."""

from dataclasses import replace

import pytest
from support.labs import fake_lab
from support.trials import experiment

from tetractl.core.errors import AbortError
from tetractl.core.poses import Pose
from tetractl.lab.preflight import inspect


def looked_over(change=lambda camera: None):
    """The preflight of a lab after its camera has changed."""
    lab = fake_lab(experiment().setup)
    with lab.plant.rig as rig:
        change(lab.camera)
        return inspect(rig)


def test_a_good_lab_has_no_problem():
    assert looked_over().problems == ()


def test_a_camera_whose_frames_are_all_dropped_is_a_problem_with_a_reason():
    """Regression: all of the frames watched were dropped, and nothing was wrong."""

    def outdate(camera):
        frames = camera.frames

        def older():
            return [replace(frame, sampled_ns=0) for frame in frames()]

        camera.frames = older

    found = looked_over(outdate)
    assert not found.ready
    (problem,) = found.problems
    assert problem.startswith("no new camera frame for 0.")
    assert "outdated frames came" in problem


def test_a_silent_camera_is_a_problem():
    def silence(camera):
        camera.silent = True

    (problem,) = looked_over(silence).problems
    assert problem.startswith("no new camera frame for 0.5")


def test_a_camera_whose_program_ends_meanwhile_is_the_problem():
    """Regression: its frames were reported as missing."""

    def end(camera):
        camera.silent, camera.frames = True, gone

    def gone():
        raise AbortError("the program of the camera has ended")

    assert looked_over(end).problems == ("the program of the camera has ended",)


@pytest.mark.parametrize(
    ("age_ms", "said"), [(90, ()), (110, ("frames are 110 ms old on arrival",))]
)
def test_frames_that_are_old_on_arrival_are_a_problem(age_ms, said, monkeypatch):
    monkeypatch.setattr("support.labs.LATENCY_NS", age_ms * 1_000_000)
    assert looked_over().problems == said


@pytest.mark.parametrize("x", [1000.0, -5000.0])
def test_what_is_no_robot_must_not_stand_in_the_arena(x):
    def place(camera):
        frames = camera.frames
        camera.frames = lambda: [
            replace(frame, strangers=(Pose(x, 700.0, 0.0),)) for frame in frames()
        ]

    inside = ("something else stands in the arena at 1000, 700 mm",)
    assert looked_over(place).problems == (inside if x > 0 else ())
