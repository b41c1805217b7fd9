"""Tests of turning a server's messages into camera frames: order, times, bodies and faults."""

import struct

import pytest

from tetractl.core.clock import SECOND
from tetractl.lab.cameras.optitrack import natnet, stream, wire
from tetractl.lab.cameras.optitrack.natnet import MessageKind, Placement, UpAxis, Version
from tetractl.lab.cameras.optitrack.section import TrackedRobot
from tetractl.lab.cameras.optitrack.stream import (
    AGE_MAX_NS,
    DRIFT_MAX,
    UNITS_SETTING,
    UP_AXIS_SETTING,
    ClockSync,
    NatNetStream,
    OpenRequests,
)

HZ = 1_000_000  # ticks of the server's clock per second: one is a microsecond
MS = SECOND // 1000
ROBOTS = (
    TrackedRobot(name="green", body="G"),
    TrackedRobot(name="blue", body=12, heading_offset=0.5),
)
V41 = Version(4, 1)


def body(number, x=0.0, valid=True):
    return natnet.RigidBody(number, (x, 2.0, 0.1), (0.0, 0.0, 0.0, 1.0), valid)


def frame(number, *bodies, exposure=0, params=0):
    return natnet.NatNetFrame(number, bodies, params, exposure)


def streaming(*, up=UpAxis.Z, synced=True, model=(("G", 11),), clock_hz=HZ, offset_ns=0):
    """A stream that knows its server, its bodies and, if `synced`, its clock."""
    made = NatNetStream(ROBOTS, Placement(0.0, 0.0, 0.0, 1000.0), up=up)
    made.record_request(natnet.Connect())
    take(made, natnet.ServerInfo("Motive", V41, clock_hz, 1511))
    if model is not None:
        take(made, natnet.ModelDef(model))
    if synced:
        for k in range(3):
            sent_ns = k * 100 * MS
            made.clock_sync.add(sent_ns, sent_ns + 2000, (sent_ns + 1000 + offset_ns) // 1000)
    return made


def take(made, message, received_ns=0):
    made._process(message, received_ns)
    return made.newest


def test_a_frame_is_exposed_at_the_servers_time_on_the_hosts_clock():
    made = streaming(offset_ns=7 * SECOND)
    seen = take(made, frame(5, body(11), exposure=8 * HZ), SECOND + 20 * MS)
    assert seen.sampled_ns == pytest.approx(SECOND, abs=2000)
    assert (seen.received_ns, seen.number) == (SECOND + 20 * MS, 5)


def test_without_a_clock_or_an_exposure_a_frame_is_exposed_when_it_arrives():
    for made, exposure in [(streaming(synced=False), 5), (streaming(), None)]:
        assert take(made, frame(5, exposure=exposure), SECOND).sampled_ns == SECOND
    assert streaming(clock_hz=0, synced=False).clock_sync is None


def test_a_frame_is_never_exposed_after_it_arrived():
    made = streaming()
    seen = take(made, frame(5, exposure=HZ), SECOND - 500)
    assert seen.sampled_ns == SECOND - 500


@pytest.mark.parametrize(
    ("age_ns", "is_taken"),
    [(AGE_MAX_NS - MS, True), (AGE_MAX_NS + MS, False), (-10 * SECOND, False), (0, True)],
)
def test_a_frame_of_an_impossible_time_is_damaged(age_ns, is_taken):
    made = streaming()
    exposed_ns = 70 * SECOND
    datagram_of = frame(5, exposure=exposed_ns // 1000)
    if is_taken:
        assert take(made, datagram_of, exposed_ns + age_ns).number == 5
        return
    for _ in range(4):
        with pytest.raises(wire.WireError, match="not plausible"):
            take(made, datagram_of, exposed_ns + age_ns)
    assert made.newest is None
    seen = take(made, datagram_of, exposed_ns + age_ns)  # the fifth in a row
    assert seen.sampled_ns == exposed_ns + age_ns
    when = "before" if age_ns > 0 else "after"
    assert f"{abs(age_ns) / SECOND:.3f} s {when} reception" in seen.fault


def test_damaged_times_that_are_not_in_a_row_are_no_fault():
    made = streaming()
    for number in range(1, 30):
        good_ns = SECOND + number * 10 * MS
        if number % 5:
            with pytest.raises(wire.WireError):
                take(made, frame(number, exposure=0), good_ns + AGE_MAX_NS)
        else:
            assert take(made, frame(number, exposure=good_ns // 1000), good_ns).fault == ""


@pytest.mark.parametrize("number", [20, 19, 12, 10])
def test_a_frame_that_was_overtaken_by_few_is_left_out_without_a_clock(number):
    made = streaming(synced=False)
    take(made, frame(20), SECOND)
    seen = take(made, frame(number), SECOND + MS)
    assert (seen.number, made.counts.frames, seen.fault) == (20, 1, "")


def test_a_counter_that_went_back_far_is_a_fault_of_its_frames():
    made = streaming(synced=False)
    take(made, frame(20), SECOND)
    seen = take(made, frame(9), SECOND + MS)
    assert seen.number == 9
    assert "the frame counter went back from 20 to 9" in seen.fault
    assert "went back" in take(made, frame(10), SECOND + 2 * MS).fault, "the fault stays"


def test_an_older_exposure_was_overtaken_however_far_its_number_is():
    made = streaming()
    take(made, frame(200, exposure=HZ), SECOND + MS)
    seen = take(made, frame(3, exposure=HZ - 1000), SECOND + 2 * MS)
    assert (seen.number, seen.fault) == (200, "")
    later = take(made, frame(3, exposure=HZ + 5000), SECOND + 9 * MS)
    assert "went back from 200 to 3" in later.fault


def test_frames_are_counted_and_name_their_bodies():
    made = streaming()
    take(made, frame(1, body(11), body(7), exposure=0), MS)
    assert made.streamed_ids == (11, 7)
    assert made.list_missing_bodies() == [12]
    take(made, frame(2, body(12), exposure=1000), 2 * MS)
    assert made.list_missing_bodies() == ["G"]
    assert made.counts.frames == 2


def test_robots_have_the_poses_of_their_bodies_and_the_rest_are_unknown_objects():
    made = streaming()
    seen = take(made, frame(1, body(7, 3.0), body(12, 1.0), body(11, 2.0)), MS)
    assert [pose.x for pose in seen.poses] == [2000, 1000]
    assert [pose.heading for pose in seen.poses] == [0, 0.5]
    assert [pose.x for pose in seen.unknown_objects] == [3000]
    untracked = take(made, frame(2, body(11, valid=False), body(7, valid=False)), 2 * MS)
    assert (untracked.poses, untracked.unknown_objects) == ((None, None), ())


def test_a_name_that_no_model_has_is_no_body():
    made = streaming(model=(("other", 11),))
    assert take(made, frame(1, body(11), body(12)), MS).poses[0] is None
    assert (made.find_id("G"), made.find_id(12)) == (None, 12)
    assert made.list_missing_bodies() == ["G"]


def test_no_pose_is_known_before_the_axis_that_points_up():
    made = streaming(up=None)
    seen = take(made, frame(1, body(11), body(12), body(7)), MS)
    assert (seen.poses, seen.unknown_objects) == ((None, None), ())


def test_two_bodies_with_a_robots_name_or_number_are_a_fault():
    named = streaming(model=(("G", 11), ("G", 13), ("other", 4), ("other", 5)))
    assert "2 rigid bodies named 'G', with the ids 11 and 13" in take(named, frame(1), MS).fault
    honest = streaming(model=(("G", 11), ("other", 4), ("other", 5)))
    assert take(honest, frame(1, body(11), body(4), body(4)), MS).fault == ""
    seen = take(honest, frame(2, body(12), body(12), body(11)), 2 * MS)
    assert "2 rigid bodies with the id 12" in seen.fault
    assert [pose is None for pose in seen.poses] == [False, True]
    assert take(honest, frame(3, body(12), body(11)), 3 * MS).fault == "", "in that frame only"


@pytest.mark.parametrize(("params", "fault"), [(0, ""), (4, stream.EDIT_MODE)])
def test_a_recording_is_a_fault_while_it_is_streamed(params, fault):
    made = streaming()
    assert take(made, frame(1, params=params), MS).fault == fault
    assert take(made, frame(2), 2 * MS).fault == ""


def test_changed_models_are_remembered_until_the_next_model():
    made = streaming()
    take(made, frame(1, params=2), MS)
    assert (made.models_changed, made.is_changing) == (True, True)
    take(made, frame(2), 2 * MS)
    assert (made.models_changed, made.is_changing) == (True, False)
    take(made, natnet.ModelDef((("G", 14),)))
    assert (made.models_changed, made.find_id("G")) == (False, 14)


def test_the_first_server_counts_and_a_pinned_version_is_that_of_its_frames():
    made = streaming()
    take(made, natnet.ServerInfo("another", Version(3, 0), 5, 1))
    assert (made.info.name, made.version) == ("Motive", V41)
    pinned = NatNetStream(ROBOTS, Placement(0, 0, 0, 1), pinned=Version(3, 1))
    take(pinned, natnet.ServerInfo("Motive", V41, HZ, 1511))
    assert pinned.version == Version(3, 1)


def answered(made, request, payload):
    made.record_request(natnet.NatNetRequest(request))
    datagram = wire.pack_datagram(MessageKind.RESPONSE, payload)
    made.feed(datagram, 0)
    return made


@pytest.mark.parametrize(("answer", "up"), [(1, UpAxis.Y), (2, UpAxis.Z), (0, None), (3, None)])
def test_the_servers_axis_is_taken_if_the_spec_states_none(answer, up):
    made = answered(streaming(up=None), UP_AXIS_SETTING, struct.pack("<i", answer))
    assert (made.up_axis, made.up_axis_answer) == (up, answer)
    stated = answered(streaming(up=UpAxis.Y), UP_AXIS_SETTING, struct.pack("<i", answer))
    assert (stated.up_axis, stated.up_axis_answer) == (UpAxis.Y, None)


@pytest.mark.parametrize(
    ("unit_mm", "taken", "is_fault"),
    [
        (1000.0, True, False),
        (1000.9, True, False),
        (999.1, True, False),
        (1001.5, True, True),
        (998.5, True, True),
        (1.0, True, True),
        (0.00101, True, True),
        (0.00099, False, False),
        (1.1e6, False, False),
        (float("nan"), False, False),
    ],
)
def test_a_server_in_another_unit_than_metres_is_a_fault(unit_mm, taken, is_fault):
    made = answered(streaming(), UNITS_SETTING, struct.pack("<f", unit_mm))
    assert (made.unit_mm is not None, made.counts.unread) == (taken, 0 if taken else 1)
    fault = take(made, frame(1), MS).fault
    assert ("instead of metres" in fault) is is_fault


def test_an_answer_that_nobody_asked_for_changes_nothing():
    made = streaming(up=None)
    made.feed(wire.pack_datagram(MessageKind.RESPONSE, struct.pack("<i", 1)), 0)
    assert made.up_axis is None
    echo = wire.pack_datagram(MessageKind.ECHO_RESPONSE, struct.pack("<QQ", 5, 7))
    assert made.feed(echo, 0) is None
    assert (made.counts.unrequested, made.counts.unread) == (1, 0)


def test_datagrams_that_cannot_be_read_are_counted_by_their_kind():
    made = NatNetStream(ROBOTS, Placement(0, 0, 0, 1))
    bad = {kind: wire.pack_datagram(kind, b"?") for kind in MessageKind}
    for kind in (MessageKind.FRAME, MessageKind.MODELDEF):
        assert made.feed(bad[kind], 0) is None
    assert made.counts.unread == 0, "the version is not known yet"
    made.feed(bad[MessageKind.SERVER_INFO], 0)
    assert made.counts.unread == 1
    made = streaming()
    for kind in (MessageKind.FRAME, MessageKind.MODELDEF, MessageKind.ECHO_RESPONSE):
        made.feed(bad[kind], 0)
    counts = made.counts
    assert (counts.unread, counts.unread_frames, counts.unread_models) == (3, 1, 1)
    assert made.last_unread_frame == bad[MessageKind.FRAME]


def test_an_echo_sets_the_clock_and_a_jump_of_it_is_a_fault_that_stays():
    made = streaming()
    for sent_ns, gained_ns in [(SECOND, 0), (2 * SECOND, 50 * MS)]:
        made.record_request(natnet.EchoRequest(sent_ns))
        ticks = (sent_ns + MS + gained_ns) // 1000
        payload = struct.pack("<QQ", sent_ns, ticks)
        made.feed(wire.pack_datagram(MessageKind.ECHO_RESPONSE, payload), sent_ns + 2 * MS)
        fault = take(made, frame(sent_ns // MS, exposure=None), sent_ns + 3 * MS).fault
        assert ("gained 50.0 ms" in fault) is bool(gained_ns)


def test_an_exchange_of_more_than_a_second_or_of_less_than_nothing_is_ignored():
    for sent_ns, returned_ns, taken in [
        (0, SECOND, True),
        (0, SECOND + 1, False),
        (5, 4, False),
        (5, 5, True),
    ]:
        sync = ClockSync(HZ)
        sync.add(sent_ns, returned_ns, 0)
        assert sync.is_synced is taken


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("beyond", "is_fault"), [(0.9, False), (1.1, True)])
def test_a_clock_may_drift_by_its_limit_beyond_what_is_unsure(sign, beyond, is_fault):
    """Round trips of 2 ms leave 2 ms unsure, and a minute at the limit makes 60 ms more."""
    span_s = 60
    off_ms = beyond * (2 + 1000 * DRIFT_MAX * span_s)
    sync = ClockSync(HZ)
    for at_s, off in [(0, 0.0), (span_s, sign * off_ms)]:
        sent_ns = at_s * SECOND
        sync.add(sent_ns, sent_ns + 2 * MS, 10**9 + round((at_s + (1 + off) / 1000) * HZ))
    assert bool(sync.fault) is is_fault
    if is_fault:
        assert (" gained " if sign > 0 else " lost ") in sync.fault


def test_the_error_grows_with_the_time_from_the_echo_in_both_directions():
    sync = ClockSync(HZ)
    sync.add(10 * SECOND, 10 * SECOND + 4 * MS, 0)
    at_ns = 10 * SECOND + 2 * MS
    here_ns = sync.error_ns(at_ns)
    assert here_ns == pytest.approx(2 * MS, abs=3000)
    for off_ns in (5 * SECOND, -5 * SECOND):
        assert sync.error_ns(at_ns + off_ns) - here_ns == pytest.approx(10 * MS, abs=1)


def test_the_newest_of_the_shortest_round_trips_converts_times():
    sync = ClockSync(HZ)
    trips_ms = [2, 9, 2, 9, 3, 9, 9, 9]  # the quarter with the shortest: both of 2 ms
    for k, trip_ms in enumerate(trips_ms):
        sent_ns = k * 100 * MS
        sync.add(sent_ns, sent_ns + trip_ms * MS, (sent_ns + trip_ms * MS // 2) // 1000)
    assert sync.round_trip_ns == 2 * MS
    assert sync.error_ns(201 * MS) == min(sync.error_ns(k * 100 * MS + MS) for k in range(8))


def test_a_drift_is_fitted_over_five_seconds_and_within_its_limit():
    for span_s, drift, fitted in [
        (4.9, 5e-4, 0.0),
        (5.1, 5e-4, 5e-4),
        (5.1, -5e-4, -5e-4),
        (9.0, 2e-3, DRIFT_MAX),
        (9.0, -2e-3, -DRIFT_MAX),
    ]:
        sync = ClockSync(HZ)
        for k in range(10):
            sent_ns = round(k / 9 * span_s * SECOND)
            ticks = round((sent_ns + MS) / SECOND * (1 + drift) * HZ)
            sync.add(sent_ns, sent_ns + 2 * MS, ticks)
            for _ in range(3):  # slow ones, so that the quarter that counts spans all the time
                sync.add(sent_ns, sent_ns + 9 * MS, ticks)
        assert sync.drift == pytest.approx(fitted, rel=0.05, abs=1e-6)


def test_only_requests_that_have_answers_are_kept_open():
    requests = OpenRequests()
    requests.add(natnet.BareMessage(MessageKind.KEEPALIVE))
    assert not requests.close(natnet.ModelDef(()))
    assert requests.close(natnet.BareMessage(MessageKind.TEXT))
