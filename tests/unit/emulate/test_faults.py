"""Every fault of a script can be seen where a real one would be: on the wires."""

import itertools
import math
from pathlib import Path

import pytest
import serial
from support.emulated_lab import Client, emulated, turn_until

from tetractl.emulate.optitrack.server import CLOCK_HZ
from tetractl.lab.actuators.m3pi.broadcast import (
    BroadcastCommand,
    Flag,
    decode_reply,
    encode_command,
)
from tetractl.lab.actuators.xbee.frames import AtCommand, Receive16, Transmit16
from tetractl.lab.actuators.xbee.framing import Decoder, encode
from tetractl.lab.cameras.optitrack.messages import (
    Connect,
    EchoRequest,
    EchoResponse,
    NatNetFrame,
    ServerInfo,
)
from tetractl.lab.cameras.optitrack.wire import parse
from tetractl.lab.errors import WireError

RUN = ((60, 60), (60, 60))


@pytest.fixture
def faulty(tmp_path):
    """Return a function that opens a lab and a client under a fault that starts at once."""
    open_now = []

    def start(fault, since="start"):
        told = []
        lab = emulated(
            tmp_path,
            script=f"faults: [{{{fault}, since: {since}}}]",
            tell=lambda event, facts: told.append((event, facts.get("name"), facts.get("phase"))),
        )
        lab.told = told
        lab.__enter__()
        client = Client(lab)
        open_now.extend((lab, client.socket))
        return lab, client

    yield start
    for thing in reversed(open_now):
        thing.close()


def frames(lab, client, count=3):
    client.ask(Connect(), ServerInfo)
    return client.next(NatNetFrame, count)


def fault_seen(lab, name):
    turn_until(lab, lambda: ("fault", name, "start") in lab.told)


def test_no_server(faulty):
    lab, client = faulty("fault: no_server")
    client.send(Connect())
    fault_seen(lab, "no_server")
    before = lab.timeline.now_ns
    turn_until(lab, lambda: lab.timeline.now_ns > before + 100_000_000)
    assert client.poll() == []


def test_no_frames(faulty):
    lab, client = faulty("fault: no_frames")
    assert client.ask(Connect(), ServerInfo)
    before = lab.timeline.now_ns
    turn_until(lab, lambda: lab.timeline.now_ns > before + 100_000_000)
    assert not [message for message in client.poll() if isinstance(message, NatNetFrame)]


def test_freeze_repeats_one_frame(faulty):
    lab, client = faulty("fault: freeze, for: 0.2")
    client.ask(Connect(), ServerInfo)
    turn_until(lab, lambda: ("fault", "freeze", "end") in lab.told)
    client.next(NatNetFrame, 4)
    got = [frame.number for frame in client.got if isinstance(frame, NatNetFrame)]
    while got[-1] == got[0]:
        client.next(NatNetFrame, len(got) + 1)
        got = [frame.number for frame in client.got if isinstance(frame, NatNetFrame)]
    assert got.count(got[0]) > 5
    assert got[-1] > got[0] + 5


def test_counter_back(faulty):
    lab, client = faulty("fault: counter_back, frames: 500, at: 0.1", since="client")
    client.ask(Connect(), ServerInfo)
    fault_seen(lab, "counter_back")
    client.next(NatNetFrame)
    numbers = [frame.number for frame in client.poll() if isinstance(frame, NatNetFrame)]
    steps = {b - a for a, b in itertools.pairwise(numbers)}
    assert steps == {1, -499}


def test_edit_mode(faulty):
    lab, client = faulty("fault: edit_mode")
    assert all(frame.edit_mode for frame in frames(lab, client)[1:])


def test_bad_datagrams_are_all_refused(faulty):
    lab, client = faulty("fault: bad_datagrams, share: 1")
    client.send(Connect())
    refused = []

    def drain():
        try:
            while True:
                datagram = client.socket.recv(65535)
                try:
                    message = parse(datagram, client.version)
                    assert isinstance(message, ServerInfo)
                except WireError:
                    refused.append(datagram)
        except BlockingIOError:
            return len(refused) > 20

    turn_until(lab, drain)


def test_other_version(faulty):
    lab, client = faulty("fault: other_version, version: '3.0'")
    client.send(Connect())

    def refused():
        try:
            client.poll()
        except WireError:
            return True

    turn_until(lab, refused)


def test_untracked_holds_the_last_pose(faulty):
    lab, client = faulty("fault: untracked, robot: blue", since="client")
    client.ask(Connect(), ServerInfo)
    fault_seen(lab, "untracked")
    lab.actuator.robot("blue").place(900, 900, 0)
    client.got.clear()
    frame = client.next(NatNetFrame, 3)[-1]
    green, blue = frame.bodies
    assert (green.tracking_valid, blue.tracking_valid) == (True, False)
    assert blue.position == pytest.approx((0.5, 0.06, -1.5))


def test_jump(faulty):
    lab, client = faulty("fault: jump, robot: green, by: [300, -100]")
    green, _ = frames(lab, client)[-1].bodies
    assert green.tracking_valid
    assert green.position == pytest.approx((0.8, 0.06, -0.4))


def echoed(lab, client, sent):
    """The server's clock in an echo [s], and the timeline's time then."""
    answer = client.ask(EchoRequest(sent), EchoResponse)
    return answer.server / CLOCK_HZ, lab.timeline.now_ns / 1e9


@pytest.mark.parametrize("by", [0.5, -0.5])
def test_clock_jump(faulty, by):
    lab, client = faulty(f"fault: clock_jump, by: {by}", since="client")
    before, then = echoed(lab, client, 1)
    client.ask(Connect(), ServerInfo)
    fault_seen(lab, "clock_jump")
    after, now = echoed(lab, client, 2)
    assert after - before - (now - then) == pytest.approx(by, abs=0.1)
    frame = client.next(NatNetFrame, 3)[-1]
    exposed = frame.ticks.exposure / CLOCK_HZ
    assert exposed - lab.timeline.now_ns / 1e9 == pytest.approx(after - now, abs=0.1)


def test_clock_rate(faulty):
    lab, client = faulty("fault: clock_rate, rate: 3", since="client")
    client.ask(Connect(), ServerInfo)
    fault_seen(lab, "clock_rate")
    before, then = echoed(lab, client, 1)
    turn_until(lab, lambda: lab.timeline.now_ns / 1e9 > then + 0.2)
    after, now = echoed(lab, client, 2)
    assert (after - before) / (now - then) == pytest.approx(3, rel=0.1)


def test_twin_id(faulty):
    lab, client = faulty("fault: twin_id, robot: blue, other: green")
    assert [body.id for body in frames(lab, client)[-1].bodies] == [1, 1]


def test_swap(faulty):
    lab, client = faulty("fault: swap, robot: green, other: blue")
    by_id = {body.id: body.position for body in frames(lab, client)[-1].bodies}
    assert by_id[1] == pytest.approx((0.5, 0.06, -1.5))
    assert by_id[7] == pytest.approx((0.5, 0.06, -0.5))


def test_nan_and_bad_quaternion(faulty):
    lab, client = faulty("fault: nan, robot: green")
    green, _ = frames(lab, client)[-1].bodies
    assert green.tracking_valid and all(map(math.isnan, green.position))


def test_bad_quaternion(faulty):
    lab, client = faulty("fault: bad_quaternion, robot: green")
    green, _ = frames(lab, client)[-1].bodies
    assert green.tracking_valid
    assert math.hypot(*green.quaternion) == pytest.approx(0.5)


@pytest.fixture
def driven(faulty):
    """Return a function that sends frames to the robots of a faulty lab."""
    ports = []

    def start(fault):
        lab, _ = faulty(fault)
        port = serial.Serial(str(lab.actuator.port.link), 57600, timeout=0, write_timeout=0.3)
        ports.append(port)
        turn_until(lab, lambda: ("fault", fault.split()[1].strip(","), "start") in lab.told)

        def send(sequence, *wheels, flags=Flag.RUN):
            payload = encode_command(BroadcastCommand(sequence, flags, wheels))
            port.write(encode(Transmit16(0, 0xFFFF, 0, payload)))

        return lab, port, send

    yield start
    for port in ports:
        port.close()


def test_veer_and_stop(driven):
    lab, _, send = driven("fault: veer, robot: green, counts: [80, 40]")
    send(1, *RUN)
    turn_until(lab, lambda: lab.actuator.robot("blue").counts() == (60, 60))
    assert lab.actuator.robot("green").counts() == (80, 40)
    send(2, flags=Flag(0))
    turn_until(lab, lambda: all(robot.standing for robot in lab.actuator.robots))


def test_wheel_stuck(driven):
    lab, _, send = driven("fault: wheel_stuck, robot: green, wheel: left")
    send(1, *RUN)
    turn_until(lab, lambda: lab.actuator.robot("green").right > 100)
    assert lab.actuator.robot("green").left == 0.0


def replies(lab, port, send, count):
    decoder, got = Decoder(), []
    send(9, flags=Flag.POLL)

    def enough():
        got.extend(f for f in decoder.feed(port.read(4096)) if isinstance(f, Receive16))
        return len(got) >= count

    turn_until(lab, enough)
    before = lab.timeline.now_ns
    turn_until(lab, lambda: lab.timeline.now_ns > before + 60_000_000)
    enough()
    return [decode_reply(frame.data[:-1]) for frame in got]


def test_off(driven):
    assert [r.id for r in replies(*driven("fault: off, robot: green"), 1)] == [1]


def test_wrong_id(driven):
    found = replies(*driven("fault: wrong_id, robot: green, id: 5"), 2)
    assert sorted(reply.id for reply in found) == [1, 5]


def test_low_battery(driven):
    lab, port, send = driven("fault: low_battery, robot: green, millivolts: 3900")
    assert [r.battery_mv for r in replies(lab, port, send, 2)] == [3900, 5100]


def test_loss_of_everything(driven):
    lab, _, send = driven("fault: loss, share: 1")
    send(1, *RUN)
    before = lab.timeline.now_ns
    turn_until(lab, lambda: lab.timeline.now_ns > before + 50_000_000)
    assert not any(any(robot.counts()) for robot in lab.actuator.robots)


def test_unplug(faulty):
    lab, _ = faulty("fault: unplug, at: 0.05")
    port = serial.Serial(str(lab.actuator.port.link), 57600, timeout=0, write_timeout=0.3)
    try:
        fault_seen(lab, "unplug")
        assert not lab.actuator.port.link.exists()
        with pytest.raises(serial.SerialException):
            port.write(b"x")
    finally:
        port.close()


def test_stuck_port(driven):
    _, port, _ = driven("fault: stuck_port")
    with pytest.raises(serial.SerialTimeoutException):
        port.write(encode(AtCommand(1, b"HV")))


def test_a_mark_is_only_told(faulty):
    lab, _ = faulty("fault: mark, name: now")
    fault_seen(lab, "mark")


def test_faults_since_run_wait_for_the_first_wheel_command(driven):
    lab, _port, send = driven("fault: mark, name: x")
    assert ("run", None, None) not in lab.told
    send(1, (0, 0), (0, 0))
    send(2, *RUN)
    turn_until(lab, lambda: ("run", None, None) in lab.told)


@pytest.mark.slow
def test_robots_are_put_back_and_restarted(tmp_path):
    told = []
    lab = emulated(tmp_path, replace_after=0.1, tell=lambda event, facts: told.append(event))
    with lab:
        green = lab.actuator.robot("green")
        green.hear(encode_command(BroadcastCommand(1, Flag.RUN, RUN)))
        turn_until(lab, lambda: green.x > 510)
        green.hear(encode_command(BroadcastCommand(2, Flag.EMERGENCY_STOP)))
        turn_until(lab, lambda: not lab.camera.tracked[0].tracked)
        assert not green.powered
        turn_until(lab, lambda: "placed" in told)
        assert (green.x, green.y, green.heading) == (500, 500, 0.5)
        green.hear(encode_command(BroadcastCommand(3, Flag.RUN, RUN)))
        assert green.counts() == (60, 60)


def open_files():
    return {path.name for path in Path("/proc/self/fd").iterdir()}


def test_nothing_is_left_open(tmp_path):
    before = open_files()
    for _ in range(3):
        with emulated(tmp_path) as lab:
            lab.actuator.unplug()
            lab.actuator.plug()
    assert open_files() == before
    assert [path.name for path in tmp_path.iterdir()] == ["record.jsonl"]
