"""Tests of the checks before robots move, with a fake camera and actuator in virtual time."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from testkit.labs import fake_lab
from testkit.trials import experiment

from tetractl.core.errors import AbortError
from tetractl.core.poses import CameraFrame, Pose, Poses
from tetractl.core.protocols import RobotStatus
from tetractl.core.trial import EMULATED_DEVICES_FACT
from tetractl.lab.frames import AcceptedFrame
from tetractl.lab.preflight import (
    Preflight,
    RobotFinding,
    _compute_latency_ms,
    describe_unplaced,
    inspect,
    inspect_lab,
)
from tetractl.lab.rig import Rig
from tetractl.spec.lab_section import LabLimits


def looked_over(change=lambda camera: None):
    """The preflight of a lab after its camera has changed."""
    lab = fake_lab(experiment().setup)
    with lab.plant.rig as rig:
        change(lab.camera)
        return inspect(rig)


def test_a_good_lab_has_no_problem():
    assert looked_over().problems == ()


def test_facts_name_emulated_devices_only_if_there_are_any(monkeypatch):
    assert EMULATED_DEVICES_FACT not in looked_over().facts
    monkeypatch.setattr(Rig, "list_emulated", lambda *devices: ["camera", "robots"])
    assert looked_over().facts[EMULATED_DEVICES_FACT] == "camera, robots"


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
    report = inspect_lab(rig)
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
    ("age_ms", "said"),
    [
        (90, ()),
        (110, ("camera frames are 110 ms old on arrival, but limits.latency allows only 100 ms",)),
    ],
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

    inside = ("an unknown object is in the arena at 1000, 700 mm: remove it",)
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


def placed_rig(poses, mm=1.0, **limits):
    """A lab of robots that start at (10, 20) mm with heading 3 rad, and are seen at these poses."""
    count = len(poses)
    starts = Poses(np.full(count, 10.0 / mm), np.full(count, 20.0 / mm), np.full(count, 3.0))
    frame = CameraFrame(1, 0, 0, tuple(poses))
    seen = AcceptedFrame(frame, frame.poses, tuple(pose is not None for pose in poses))
    return SimpleNamespace(
        mm_per_unit=mm,
        limits=LabLimits(**limits),
        setup=SimpleNamespace(names=("green", "blue")[:count], starts=starts),
        loop=SimpleNamespace(frames=SimpleNamespace(newest=seen)),
        describe_untracked=lambda i: f"robot {i} is not tracked",
    )


LIMITS = {"start_mm": 30.0, "start_heading": 0.3}
MOST_MM = "(at most 30 mm are allowed)"
MOST_RAD = "(at most 0.3 rad are allowed)"


@pytest.mark.parametrize("mm", [1.0, 1000.0, 0.001])
@pytest.mark.parametrize(
    ("dx", "dy", "turned", "says"),
    [
        (0, 0, 0.0, None),
        (29.9, 0, 0.29, None),
        (0, -29.9, -0.29, None),
        (18, 24.1, 0.0, f"green is 30 mm from its start {MOST_MM}"),
        (-40, 0, 1.0, f"green is 40 mm from its start {MOST_MM}"),
        (0, 0, 0.31, f"green is turned by +0.31 rad from its start heading {MOST_RAD}"),
        (0, 0, -0.31, f"green is turned by -0.31 rad from its start heading {MOST_RAD}"),
        (0, 0, 0.29 + math.tau, None),
    ],
)
def test_a_robot_is_on_its_start_within_the_limits_in_any_unit(mm, dx, dy, turned, says):
    pose = Pose((10 + dx) / mm, (20 + dy) / mm, 3.0 + turned)
    assert describe_unplaced(placed_rig([pose], mm, **LIMITS)) == ([says] if says else [])


def test_a_robot_that_is_not_seen_is_named_as_that_and_not_as_misplaced():
    lines = describe_unplaced(placed_rig([Pose(10.0, 20.0, 3.0), None], **LIMITS))
    assert lines == ["robot 1 is not tracked"]


@pytest.mark.parametrize(
    ("turned", "says"),
    [
        ((math.pi / 2, math.pi / 2 + 0.29), True),
        ((math.pi / 2, math.pi / 2 + 0.31), False),
        ((math.pi / 2 - 0.29, math.pi / 2), True),
        ((math.pi / 2, -math.pi / 2), False),
        ((0.0, 0.0), False),
        ((math.pi, -math.pi), True),
    ],
)
def test_quarter_turns_are_told_within_the_limit_of_headings(turned, says):
    poses = [Pose(10.0, 20.0, 3.0 + angle) for angle in turned]
    lines = [
        line for line in describe_unplaced(placed_rig(poses, **LIMITS)) if "does each tag" in line
    ]
    assert len(lines) == says
    elsewhere = [poses[0], Pose(99.0, 20.0, poses[1].heading)]
    lines = describe_unplaced(placed_rig(elsewhere, **LIMITS))
    assert not any("does each tag" in line for line in lines), "it may be another robot's place"


def test_one_robot_that_is_turned_is_named():
    lines = describe_unplaced(placed_rig([Pose(10.0, 20.0, 3.0 + math.pi / 2)], **LIMITS))
    assert lines[-1].startswith("green is turned by +90 degrees")
    anywhere = placed_rig([Pose(10.0, 20.0, 3.0 + math.pi / 2)], start_heading=math.pi / 2)
    assert describe_unplaced(anywhere) == []


@pytest.mark.parametrize(
    ("ages_ms", "latency_ms"),
    [([], None), ([0, 0, 0], None), ([0, 4, 0], (0, 4)), ([9, 1, 5], (5, 9)), ([2, 4], (4, 4))],
)
def test_the_age_of_frames_on_arrival_is_their_median_and_maximum(ages_ms, latency_ms):
    frames = [CameraFrame(k, 100, 100 + age * 10**6, ()) for k, age in enumerate(ages_ms)]
    assert _compute_latency_ms(frames) == latency_ms


def finding(*, misplaced="", untracked="", **status):
    return RobotFinding("green", 1.0, 0.0, misplaced, untracked, RobotStatus(None, **status))


def test_a_run_can_start_unless_anything_is_wrong():
    good = Preflight((finding(),), None, None, (), (), {}, ())
    assert good.can_start
    assert replace(good, warnings=("w",), questions=("q",)).can_start
    assert not replace(good, problems=("p",)).can_start
    assert not replace(good, robots=(finding(), finding(misplaced="m"))).can_start
    assert not replace(good, robots=(finding(untracked="u"), finding())).can_start
    bad = replace(
        good,
        robots=(finding(misplaced="m", untracked="u", problems=("s",), warnings=("w2",)),),
        problems=("p",),
        warnings=("w",),
        questions=("q",),
    )
    assert (bad.all_problems, bad.misplaced) == (("p", "u", "s"), ("m",))
    assert bad.all_warnings == ("w", "q", "w2")
