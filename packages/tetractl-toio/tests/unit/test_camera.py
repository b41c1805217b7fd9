"""Tests of the camera of cubes: how readings become poses and frames, with a connection by hand."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit.cli import tetractl
from testkit.hand_clock import HandClock
from tetractl_toio import camera as camera_module
from tetractl_toio.camera import SILENCE_MAX_NS, CubeReports, ToioCamera, compute_reading
from tetractl_toio.messages import (
    NOTIFY_MISSED,
    NOTIFY_READINGS,
    Characteristic,
    CubeReading,
    encode_reading,
)

from tetractl.core.clock import MILLISECOND, SECOND
from tetractl.core.errors import AbortError
from tetractl.core.poses import Pose
from tetractl.spec.load import load_spec

LATENCY_NS = 5 * MILLISECOND


class Link:
    """Stands for the connections to all cubes; it keeps what is sent, and answers as set up."""

    emulated = False

    def __init__(self, clock, cubes, ports, receive):
        self.cubes = cubes
        self.receive = receive
        self.sent = []
        self.respond = lambda cube, characteristic: None
        self.gone = set()
        self.is_open = False

    def open(self):
        self.is_open = True

    def close(self):
        self.is_open = False

    def send(self, cube, characteristic, data=b""):
        if cube in self.gone:
            raise AbortError("gone")
        self.sent.append((cube, characteristic, data))
        self.respond(self.cubes.index(cube), characteristic)


@pytest.fixture(scope="module")
def experiment(tmp_path_factory):
    place = tmp_path_factory.mktemp("cubes")
    tetractl(place, "init", "cubes", "--lab", "--robots", "toio").ok()
    return load_spec(place / "cubes.yaml").experiment


@pytest.fixture
def camera(experiment, monkeypatch):
    """A camera that is not entered yet, with its clock at a second."""
    monkeypatch.setattr(camera_module, "CubesLink", Link)
    clock = HandClock()
    clock.advance(1.0)
    woken = []
    made = ToioCamera(experiment.lab.camera, experiment.setup, clock, lambda: woken.append(1))
    made.clock = clock
    made.woken = woken
    made.link = made._link
    return made


def tell(camera, i, x=500, y=250, angle=0, data=None):
    """A cube reports a reading now."""
    data = encode_reading(CubeReading(x, y, angle)) if data is None else data
    camera.link.receive(i, Characteristic.ID, data, camera.clock.now())


def tell_all(camera):
    for i in range(3):
        tell(camera, i)


@given(
    x=st.floats(-500, 500),
    y=st.floats(-500, 500),
    heading=st.floats(-math.pi, math.pi),
    unit_mm=st.floats(0.5, 3),
)
def test_a_reading_has_whole_units_from_the_origin_y_down_and_turns_clockwise(
    x, y, heading, unit_mm
):
    reading = compute_reading((x, y, heading), (45, 455), unit_mm)
    assert (reading.x - 45) * unit_mm == pytest.approx(x, abs=unit_mm / 2 + 1e-9)
    assert (455 - reading.y) * unit_mm == pytest.approx(y, abs=unit_mm / 2 + 1e-9)
    assert 0 <= reading.angle < 360
    off = math.remainder(math.radians(reading.angle) + heading, math.tau)
    assert abs(off) <= math.radians(0.5) + 1e-9


def test_a_frame_has_poses_in_the_specs_unit_and_axes(camera):
    x0, y0 = camera.section.origin
    tell(camera, 0, x0 + 100, y0 - 50, 90)
    tell(camera, 1, x0, y0, 0)
    tell(camera, 2, x0 + 10, y0 - 20, 350)
    (frame,) = camera.frames()
    unit = camera.section.unit_mm / (camera.setup.metres * 1000)
    first, second, third = frame.poses
    assert (first.x, first.y, first.heading) == pytest.approx((100 * unit, 50 * unit, -math.pi / 2))
    assert (second.x, second.y, second.heading) == (0.0, 0.0, 0.0)
    assert third.heading == pytest.approx(math.radians(10))
    assert frame.number == 3
    assert len(camera.woken) == 3


def test_there_is_no_frame_before_each_cube_has_reported_nor_without_news(camera):
    tell(camera, 0)
    tell(camera, 2)
    assert camera.frames() == []
    tell(camera, 1)
    assert len(camera.frames()) == 1
    assert camera.frames() == []
    camera.clock.advance(0.01)
    assert camera.frames() == []
    tell(camera, 1)
    assert len(camera.frames()) == 1


def test_each_pose_has_the_time_of_its_own_reading_less_the_latency(camera):
    tell_all(camera)
    camera.clock.advance(0.02)
    tell(camera, 1)
    camera.clock.advance(0.003)
    (frame,) = camera.frames()
    old_ns = SECOND - LATENCY_NS
    new_ns = old_ns + 20 * MILLISECOND
    assert camera.section.latency == 0.005
    assert frame.exposed_ns == (old_ns, new_ns, old_ns)
    assert frame.sampled_ns == new_ns
    assert frame.received_ns == SECOND + 23 * MILLISECOND


def test_no_time_is_before_the_clock_began(experiment, monkeypatch):
    monkeypatch.setattr(camera_module, "CubesLink", Link)
    made = ToioCamera(experiment.lab.camera, experiment.setup, HandClock())
    for i in range(3):
        made._link.receive(i, Characteristic.ID, encode_reading(CubeReading(1, 1, 0)), 0)
    (frame,) = made.frames()
    assert frame.exposed_ns == (0, 0, 0)


def test_a_cube_off_the_mat_has_no_pose_and_is_a_problem(camera):
    tell_all(camera)
    assert camera.check().problems == ()
    camera.clock.advance(0.01)
    tell(camera, 1, data=b"\x03")
    (frame,) = camera.frames()
    assert [pose is None for pose in frame.poses] == [False, True, False]
    (problem,) = camera.check().problems
    assert problem.startswith(f"{camera.setup.names[1]} does not see the mat")


def test_what_cannot_be_decoded_is_counted_and_is_no_reading(camera):
    tell_all(camera)
    camera.frames()
    camera.clock.advance(0.01)
    tell(camera, 0, data=b"\x01\x02")
    camera.link.receive(0, Characteristic.MOTOR, b"\x01", camera.clock.now())
    assert camera.damaged == 1
    assert camera.frames() == []
    assert len(camera.woken) == 3


def test_silent_cubes_are_asked_once_in_a_while_and_those_that_report_are_not(camera):
    tell_all(camera)
    camera.frames()
    cubes = camera.link.cubes
    camera.link.sent.clear()
    camera.clock.advance_ns(SILENCE_MAX_NS - 1)
    tell(camera, 0)
    camera.frames()
    assert camera.link.sent == []
    camera.clock.advance_ns(1)
    camera.frames()
    assert camera.link.sent == [(cube, Characteristic.ID, b"") for cube in cubes[1:]]
    camera.clock.advance_ns(SILENCE_MAX_NS // 2)
    camera.frames()
    assert len(camera.link.sent) == 2
    camera.clock.advance_ns(SILENCE_MAX_NS)
    camera.frames()
    assert len(camera.link.sent) == 5


def test_a_cube_that_cannot_be_asked_does_not_end_the_frames(camera):
    tell_all(camera)
    camera.frames()
    camera.link.gone = set(camera.link.cubes[:1])
    camera.link.sent.clear()
    camera.clock.advance(0.5)
    assert camera.frames() == []
    assert [cube for cube, *_ in camera.link.sent] == list(camera.link.cubes[1:])


def answers(camera, lost):
    """Let each cube confirm its settings and report, but for the first `lost` questions."""
    asked = []

    def respond(i, characteristic):
        asked.append((i, characteristic))
        if asked.count((i, characteristic)) <= lost:
            return
        if characteristic == Characteristic.ID:
            tell(camera, i)
        if characteristic == Characteristic.CONFIGURATION:
            camera.link.receive(i, characteristic, b"\x98\0\0", camera.clock.now())

    camera.link.respond = respond
    return asked


@pytest.mark.parametrize(("lost", "questions"), [(0, 1), (2, 3), (4, 5)])
def test_cubes_are_set_and_asked_again_until_all_have_answered(camera, lost, questions):
    asked = answers(camera, lost)
    with camera:
        assert asked.count((0, Characteristic.ID)) == questions
        assert camera.link.is_open
        first = camera.link.cubes[0]
        assert camera.link.sent[:3] == [
            (first, Characteristic.CONFIGURATION, NOTIFY_READINGS),
            (first, Characteristic.CONFIGURATION, NOTIFY_MISSED),
            (first, Characteristic.ID, b""),
        ]
        assert len(camera.frames()) == 1
    assert not camera.link.is_open


def test_cubes_that_never_report_are_named_and_all_is_closed(camera):
    camera.link.respond = lambda i, characteristic: tell(camera, i) if i == 1 else None
    first, _, third = camera.setup.names
    began_ns = camera.clock.now()
    with pytest.raises(AbortError, match=f"no message came from {first}, {third}\n"), camera:
        pass
    assert camera.clock.now() - began_ns == pytest.approx(3 * SECOND, abs=SECOND // 10)
    assert not camera.link.is_open


def test_a_report_is_kept_until_the_next_of_its_cube():
    reports = CubeReports(2)
    assert reports.now()[0] == 0
    reports.note_pose(1, Pose(1.0, 2.0, 3.0), 50)
    number, (first, second) = reports.now()
    assert number == 1
    assert first.read_ns < 0
    assert (second.pose, second.read_ns) == (Pose(1.0, 2.0, 3.0), 50)
    reports.note_pose(1, None, 60)
    assert reports.now()[1][1].pose is None
    assert reports.now()[0] == 2
