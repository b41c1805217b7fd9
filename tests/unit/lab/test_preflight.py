"""What is checked before robots move, in virtual time, of a fake camera and a fake actuator."""

from dataclasses import replace

from support.labs import fake_lab
from support.trials import experiment

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
    assert "outdated ones came" in problem


def test_a_silent_camera_is_a_problem():
    def silence(camera):
        camera.silent = True

    (problem,) = looked_over(silence).problems
    assert problem.startswith("no new camera frame for 0.5")
