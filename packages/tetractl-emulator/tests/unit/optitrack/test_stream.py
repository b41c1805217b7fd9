"""Tests of converting NatNet datagrams to poses, faults, echoes and units."""

import struct

import pytest
from tetractl_emulator.optitrack.natnet_server import pack_answer

from tetractl.core.clock import SECOND
from tetractl.lab.cameras.optitrack import diagnosis, natnet
from tetractl.lab.cameras.optitrack.natnet import Placement, UpAxis
from tetractl.lab.cameras.optitrack.section import TrackedRobot
from tetractl.lab.cameras.optitrack.stream import UNITS_SETTING, UP_AXIS_SETTING, NatNetStream

pytestmark = pytest.mark.slow

V41 = natnet.Version(4, 1)
HZ = 10_000_000
INFO = natnet.ServerInfo("Motive", V41, HZ, 1511)
MODEL = natnet.ModelDef((("green", 11), ("blue", 12), ("hand", 13)))
ROBOTS = (
    TrackedRobot(name="robot", body="green"),
    TrackedRobot(name="robot", body=12, heading_offset=0.5),
)
MILLIMETRES = Placement(0.0, 0.0, 0.0, 1000.0)


def body(number, x, y, valid=True):
    return natnet.RigidBody(number, (x, y, 0.1), (0.0, 0.0, 0.0, 1.0), valid)


def frame(number, *bodies, exposure=0, params=0):
    return pack_answer(natnet.NatNetFrame(number, tuple(bodies), params, exposure), V41)


def answer_of(number_format, value):
    """The answer to a question whose answer is one number."""
    return pack_answer(natnet.Response(struct.pack(number_format, value)))


def connect(stream):
    stream.record_request(natnet.Connect())
    stream.feed(pack_answer(INFO), 0)
    tell(stream, MODEL)
    return stream


def tell(stream, model):
    stream.record_request(natnet.BareMessage(natnet.MessageKind.REQUEST_MODELDEF))
    stream.feed(pack_answer(model, V41), 0)


def connected(up=UpAxis.Z, placement=MILLIMETRES):
    return connect(NatNetStream(ROBOTS, placement, up=up))


def test_robots_are_found_by_name_and_by_id_others_are_strangers():
    stream = connected()
    bodies_in_m = [body(12, 2.0, 1.0), body(13, 0.5, 0.5), body(11, 1.0, 0.25)]
    stream.feed(frame(7, *bodies_in_m), 99)
    assert stream.newest.number == 7
    assert stream.newest.received_ns == 99
    green, blue = stream.newest.poses
    assert (green.x, green.y, green.heading) == pytest.approx((1000, 250, 0))
    assert (blue.x, blue.y, blue.heading) == pytest.approx((2000, 1000, 0.5))
    (hand,) = stream.newest.unknown_objects
    assert (hand.x, hand.y) == (500, 500)


def test_bodies_that_are_not_in_the_frames_are_told():
    stream = NatNetStream(
        (
            TrackedRobot(name="robot", body="green"),
            TrackedRobot(name="robot", body="red"),
            TrackedRobot(name="robot", body=99),
        ),
        MILLIMETRES,
        up=UpAxis.Z,
    )
    assert stream.list_missing_bodies() == ["green", "red", 99]
    connect(stream)
    assert stream.list_missing_bodies() == ["green", "red", 99]
    untracked_green = body(11, 1.0, 1.0, valid=False)
    stream.feed(frame(1, untracked_green, body(12, 1.0, 1.0)), 0)
    assert stream.list_missing_bodies() == ["red", 99]
    assert stream.streamed_ids == (11, 12)


def test_an_echo_is_taken_once_and_only_with_the_time_that_was_sent():
    stream = connected()
    stream.record_request(natnet.EchoRequest(1_000))
    assert stream.feed(pack_answer(natnet.EchoResponse(1_001, 9 * HZ)), 2_000) is None
    assert stream.feed(pack_answer(natnet.EchoResponse(1_000, 5 * HZ)), 2_000) is not None
    assert stream.feed(pack_answer(natnet.EchoResponse(1_000, 9 * HZ)), 2_000) is None
    assert stream.clock_sync.to_host(5 * HZ) == 1_500
    assert stream.counts.unrequested == 2


@pytest.mark.parametrize("exposure, fault", [(HZ // 2, ""), (HZ + 9, "the frame counter went")])
def test_a_frame_of_the_past_was_overtaken_by_however_many_and_a_new_one_counts_back(
    exposure, fault
):
    """Frame 500 was exposed after a second; then frame 400 comes, exposed before or after it."""
    stream = connected()
    stream.record_request(natnet.EchoRequest(0))
    stream.feed(pack_answer(natnet.EchoResponse(0, 0)), 0)
    stream.feed(frame(500, exposure=HZ), 2 * SECOND)
    stream.feed(frame(400, exposure=exposure), 2 * SECOND)
    assert stream.newest.fault[: len("the frame counter went")] == fault


@pytest.mark.parametrize(
    ("answer", "unit_mm", "fault"),
    [
        (1000.0, 1000.0, ""),
        (1.0, 1.0, "streams lengths in units of 1 mm instead of metres"),
        (10.0, 10.0, "streams lengths in units of 10 mm instead of metres"),
        (1.4e-45, None, ""),  # a late answer to another question
        (float("nan"), None, ""),
    ],
)
def test_a_server_that_streams_in_another_unit_than_metres_is_a_fault(answer, unit_mm, fault):
    stream = connected()
    stream.record_request(natnet.NatNetRequest(UNITS_SETTING))
    stream.feed(answer_of("<f", answer), 0)
    stream.feed(frame(1, body(11, 1.0, 1.0)), 0)
    assert stream.unit_mm == unit_mm
    assert stream.newest.fault.endswith(fault)
    assert bool(stream.newest.fault) == bool(fault)


@pytest.mark.parametrize(
    ("answer", "says", "hint"),
    [
        (None, "does not report which of its axes", "set lab.camera.up_axis to y or z"),
        (0, "up axis is x; it must be y or z", "change Up Axis in Motive's streaming settings"),
        (7, "up axis is of number 7", "change Up Axis in Motive's streaming settings"),
    ],
)
def test_a_wrong_up_axis_is_told_from_an_unknown_one(answer, says, hint):
    """Regression: x up was answered by a hint to set y or z in the spec."""
    stream = connected(up=None)
    if answer is not None:
        stream.record_request(natnet.NatNetRequest(UP_AXIS_SETTING))
        stream.feed(answer_of("<i", answer), 0)
    error = diagnosis.create_up_axis_error(stream)
    assert stream.up_axis is None
    assert says in str(error)
    assert error.hint.startswith(hint)


def test_an_exposure_that_cannot_be_is_a_bad_datagram():
    """Regression: such an age did not fit into a log."""
    stream = connected()
    stream.record_request(natnet.EchoRequest(0))
    stream.feed(pack_answer(natnet.EchoResponse(0, 2**64 - 1)), 10)
    stream.feed(frame(1, exposure=0), 20)
    assert stream.counts.unread == 1
    assert stream.counts.frames == 0
    assert stream.newest is None
