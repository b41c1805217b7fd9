"""Tests of the poses of named bodies, in the axes and the unit of the spec."""

import json
import math
import types

import pytest
from testkit.trials import experiment
from tetractl_emulator.optitrack.tracked_body import View
from tetractl_emulator.pose_stream import PoseStream
from tetractl_emulator.virtual_lab import LabClock
from tetractl_motioncapture.camera import NAMES_MAX, MotionCapture
from tetractl_motioncapture.emulated import EmulatedMotionCapture
from tetractl_motioncapture.section import MotionCaptureSection

from tetractl.core.errors import UsageError
from tetractl.lab.cameras.optitrack.natnet import UpAxis

TURN = 0.4
Z_UP = [0, 0, math.sin(TURN / 2), math.cos(TURN / 2)]
Y_UP = [0, math.sin(TURN / 2), 0, math.cos(TURN / 2)]


def section(**fields):
    robots = [{"name": "green", "body": "G", "heading_offset": 0.3}, {"name": "blue", "body": 7}]
    section = {"type": "motioncapture", "system": "vicon", "hostname": "h", "robots": robots}
    return MotionCaptureSection.model_validate(section | fields)


def setup(metres=0.001):
    return types.SimpleNamespace(names=("green", "blue"), metres=metres)


def camera(metres=0.001, **fields):
    def ports(*_):
        return types.SimpleNamespace()

    return MotionCapture(section(**fields), setup(metres), LabClock(), ports=ports)


def line(**bodies):
    return json.dumps({"bodies": bodies}).encode()


@pytest.mark.parametrize("metres", [0.001, 1.0, 1e-6])
def test_positions_are_turned_and_moved_in_the_specs_unit(metres):
    made = camera(metres, origin=(120.0, -40.0), rotation=math.pi / 2)
    green, blue = made.poses(line(**{"G": [0.1, 0.2, 0.3, *Z_UP], "7": [1, 0, 0, 0, 0, 0, 1]}))
    assert (green.x, green.y) == pytest.approx((120 - 0.2 / metres, -40 + 0.1 / metres))
    assert green.heading == pytest.approx(TURN + 0.3 + math.pi / 2)
    assert green.height == pytest.approx(0.3 / metres)
    assert (blue.x, blue.y, blue.heading) == pytest.approx((120, -40 + 1 / metres, math.pi / 2))


@pytest.mark.parametrize(("up", "turn", "along"), [("z", Z_UP, 200.0), ("y", Y_UP, -300.0)])
def test_the_floor_is_across_the_axis_that_points_up(up, turn, along):
    green, _ = camera(up_axis=up).poses(line(G=[0.1, 0.2, 0.3, *turn]))
    assert (green.x, green.y) == pytest.approx((100.0, along))
    assert green.heading == pytest.approx(TURN + 0.3)
    assert green.tilt == pytest.approx(0.0, abs=1e-6)


def test_a_body_that_is_missing_has_no_pose_and_a_robot_is_named_for_it():
    made = camera()
    assert made.poses(line(G=[0, 0, 0, *Z_UP]))[1] is None
    (problem,) = made.check().problems
    assert problem == "the system streams no rigid body 7 for blue; it streams G"
    assert made.poses(line(**{"7": [0, 0, 0, *Z_UP]}))[0] is None
    assert "body G for green" in made.check().problems[0]
    both = line(**{"G": [0, 0, 0, *Z_UP], "7": [0, 0, 0, *Z_UP]})
    assert None not in made.poses(both)
    assert made.check().problems == ()
    made.poses(line())
    assert [text.rpartition(" ")[2] for text in made.check().problems] == ["none", "none"]


@pytest.mark.parametrize(
    ("count", "rest"), [(NAMES_MAX, ""), (NAMES_MAX + 1, " and 1 more"), (60, " and 40 more")]
)
def test_at_most_so_many_streamed_names_are_listed(count, rest):
    made = camera()
    made.poses(line(**{f"body{k}": [0, 0, 0, *Z_UP] for k in range(count)}))
    problem = made.check().problems[0]
    listed = ", ".join(f"body{k}" for k in range(min(count, NAMES_MAX)))
    assert problem.endswith(f"it streams {listed}{rest}")


def test_an_emulated_stream_says_so_itself():
    made = camera()
    made.poses(line(G=[0, 0, 0, *Z_UP]))
    assert made.check().emulated is False
    made.poses(b'{"emulated": true, "bodies": {}}')
    assert made.check().emulated is True


def test_a_section_describes_its_connection_and_its_robots():
    made = section(system="qualisys", hostname="10.0.0.5")
    assert made.bounds() == {"cameras": "qualisys at 10.0.0.5"}
    assert made.address == "10.0.0.5"
    assert (made.heading_offset("green"), made.heading_offset("blue")) == (0.3, 0.0)


def test_robots_and_bodies_match_those_of_the_spec_one_to_one():
    spec_setup = experiment().setup
    names = spec_setup.names
    rows = [{"name": name, "body": name.upper()} for name in names]
    assert list(section(robots=rows).contradictions(spec_setup)) == []
    assert list(section(robots=rows[:-1]).contradictions(spec_setup))
    rows[-1]["body"] = rows[0]["body"]
    assert list(section(robots=rows).contradictions(spec_setup))


@pytest.mark.parametrize(
    ("hostname", "ports", "refused"),
    [
        ("10.0.0.5", None, True),
        ("udp://127.0.0.1:9800", None, False),
        ("10.0.0.5", "in memory", False),
    ],
)
def test_only_an_address_of_this_computer_can_be_emulated_over_a_network(
    monkeypatch, hostname, ports, refused
):
    monkeypatch.setattr(PoseStream, "__init__", lambda self, *_: setattr(self, "tracked", []))
    stage = types.SimpleNamespace(
        lab=types.SimpleNamespace(camera=section(hostname=hostname)),
        wires=types.SimpleNamespace(ports=ports),
        mm=2.0,
    )
    if refused:
        with pytest.raises(UsageError, match="cannot be emulated over a network"):
            EmulatedMotionCapture(stage, None, [])
    else:
        EmulatedMotionCapture(stage, None, [])


@pytest.mark.parametrize("up", ["y", "z"])
def test_the_emulated_cameras_stand_where_the_section_says_in_mm(monkeypatch, up):
    monkeypatch.setattr(PoseStream, "__init__", lambda self, *_: setattr(self, "tracked", []))
    camera_section = section(origin=(120.0, -40.0), rotation=0.7, up_axis=up)
    stage = types.SimpleNamespace(
        lab=types.SimpleNamespace(camera=camera_section),
        wires=types.SimpleNamespace(ports="in memory"),
        mm=2.0,
    )
    view = EmulatedMotionCapture(stage, None, []).view
    assert view == View(UpAxis.Y if up == "y" else UpAxis.Z, (240.0, -80.0), 0.7)
