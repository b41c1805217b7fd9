"""Tests of the emulated XBee radio in virtual time: what robots hear, when, and what comes back."""

from types import SimpleNamespace

import numpy as np
import pytest
from testkit.emulator.acting import act
from tetractl_emulator.faults import ActingFaults
from tetractl_emulator.loop import Timeline
from tetractl_emulator.m3pi.emulated_radio import (
    ACK_NS,
    AIR_NS_PER_BYTE,
    AIR_OVERHEAD_BYTES,
    BACKOFF_MAX_NS,
    RECEIVED_HEADER,
    ROBOT_BAUD,
    EmulatedRadio,
    encode_at_response,
)
from tetractl_emulator.m3pi.robot_radio import RobotRadio
from tetractl_emulator.port import uart_ns

from tetractl.core.clock import MILLISECOND, SECOND
from tetractl.lab.actuators.m3pi.broadcast import BroadcastCommand, decode_command, encode_command
from tetractl.lab.actuators.xbee.api_frames import AT_COMMAND, BROADCAST, Decoder, encode
from tetractl.lab.cobs import Flag, FrameSplitter

BAUD = 57600
DRIVE = encode_command(BroadcastCommand(5, Flag.RUN, ((20, 30), (-4, 0))))


class Robot:
    """Stands for a robot that keeps what it hears, and answers when a test says so."""

    def __init__(self, name, index):
        self.name = name
        self.index = index
        self.late_ns = 0
        self.heard = []
        self.answers = []

    def receive(self, data):
        self.heard.append((data, self.timeline.now_ns))

    def answer(self):
        return self.answers.pop() if self.answers else b""


class Radio:
    """An emulated radio with two robots, and the port at which a test is the program."""

    def __init__(self, loss=0.0, seed=1, record=True):
        self.timeline = Timeline(lambda when_ns: None)
        self.acting = ActingFaults()
        self.robots = [Robot("green", 0), Robot("blue", 3)]
        for robot in self.robots:
            robot.timeline = self.timeline
        self.written = []
        self.events = []
        self.waiting = []
        port = SimpleNamespace(
            name="radio",
            baud=lambda: BAUD,
            read=lambda: self.waiting.pop(0) if self.waiting else b"",
            write=lambda data: self.written.append((data, self.timeline.now_ns)),
        )
        note = (lambda event, **facts: self.events.append((event, facts))) if record else None
        versions = (0x1744, 0x10EC)
        self.radio = EmulatedRadio(
            self.timeline, port, BAUD, versions, self.robots, loss, seed, note, self.acting
        )

    def send(self, content):
        self.waiting.append(encode(content))
        self.radio.read_port()
        self.timeline.run_to(self.timeline.now_ns + SECOND // 2)

    def heard(self):
        return [[data for data, _ in robot.heard] for robot in self.robots]

    def came(self):
        """The contents of the frames that have come at the program."""
        decoder = Decoder()
        return [content for data, _ in self.written for content in decoder.feed(data)]


@pytest.mark.parametrize(
    ("command", "value"),
    [
        (b"HV", b"\x17\x44"),
        (b"VR", b"\x10\xec"),
        (b"BD", b"\0\0\0\x06"),
        (b"AP", b"\x02"),
        (b"QQ", None),
    ],
)
def test_a_question_for_a_parameter_is_answered_and_a_setting_is_refused(command, value):
    radio = Radio()
    radio.send(bytes((AT_COMMAND, 0x21)) + command)
    radio.send(bytes((AT_COMMAND, 0x22)) + command + b"\1")
    assert radio.came() == [
        encode_at_response(0x21, command, value),
        encode_at_response(0x22, command, None),
    ]
    assert radio.heard() == [[], []]
    assert radio.events == []


@pytest.mark.parametrize("content", [b"\x99unknown", bytes((AT_COMMAND, 1)), b"\x08"])
def test_other_frames_and_cut_questions_are_ignored(content):
    radio = Radio()
    radio.send(content)
    assert radio.came() == []
    assert radio.heard() == [[], []]


def test_an_answer_has_its_number_its_status_and_its_value():
    assert encode_at_response(7, b"VR", b"\x10\xec") == b"\x88\x07VR\x00\x10\xec"
    assert encode_at_response(7, b"QQ", None) == b"\x88\x07QQ\x02"
    assert encode_at_response(7, b"ND", b"") == b"\x88\x07ND\x00"


def test_a_broadcast_reaches_each_robot_once_and_is_recorded():
    radio = Radio()
    radio.send(BROADCAST + DRIVE)
    assert radio.heard() == [[DRIVE], [DRIVE]]
    wheels = ((20, 30), (-4, 0))
    assert radio.events == [("command", {"sequence": 5, "flags": Flag.RUN, "wheels": wheels})]
    assert radio.came() == []
    silent = Radio(record=False)
    silent.send(BROADCAST + DRIVE)
    assert silent.heard() == [[DRIVE], [DRIVE]]


def test_garbage_is_recorded_as_such():
    radio = Radio()
    radio.send(BROADCAST + b"\x03\x11\x22\0")
    ((event, facts),) = radio.events
    assert (event, bytes.fromhex(facts["hex"])[:3]) == ("garbage", b"\x03\x11\x22")


def test_a_broadcast_takes_its_time_on_both_wires_and_in_the_air():
    for seed in range(20):
        radio = Radio(seed=seed)
        radio.send(BROADCAST + DRIVE)
        size = len(DRIVE)
        least_ns = uart_ns(len(encode(BROADCAST + DRIVE)), BAUD)
        least_ns += (size + AIR_OVERHEAD_BYTES) * AIR_NS_PER_BYTE + uart_ns(size, ROBOT_BAUD)
        heard_ns = radio.robots[0].heard[0][1]
        assert least_ns <= heard_ns <= least_ns + BACKOFF_MAX_NS
        assert radio.robots[1].heard[0][1] == heard_ns


def test_broadcasts_wait_for_the_air_one_after_another():
    radio = Radio()
    for _ in range(5):
        radio.waiting.append(encode(BROADCAST + DRIVE))
    frame_ns = (len(DRIVE) + AIR_OVERHEAD_BYTES) * AIR_NS_PER_BYTE
    radio.radio.receive(b"".join(radio.waiting))
    radio.timeline.run_to(SECOND)
    times_ns = [at_ns for _, at_ns in radio.robots[0].heard]
    gaps_ns = np.diff(times_ns)
    assert len(times_ns) == 5
    assert (gaps_ns >= frame_ns).all()
    assert (gaps_ns <= frame_ns + BACKOFF_MAX_NS).all()


def test_a_robot_hears_late_by_the_radio_and_by_its_own_delay():
    plain = Radio()
    plain.send(BROADCAST + DRIVE)
    late = Radio()
    act(late.acting, "late_radio", by=0.1)
    act(late.acting, "late_radio", by=0.05)
    late.robots[1].late_ns = 40 * MILLISECOND
    late.send(BROADCAST + DRIVE)
    usual_ns = plain.robots[0].heard[0][1]
    assert late.robots[0].heard[0][1] - usual_ns == 150 * MILLISECOND
    assert late.robots[1].heard[0][1] - usual_ns == 190 * MILLISECOND


def test_packets_that_overtake_are_late_by_up_to_the_fault_each_by_another_time():
    radio = Radio()
    act(radio.acting, "overtaken_packets", by=0.2)
    delays_ns = [radio.radio.sample_delay_ns() for _ in range(400)]
    assert 0 <= min(delays_ns) < 0.01 * SECOND
    assert 0.19 * SECOND < max(delays_ns) <= 0.2 * SECOND
    assert Radio().radio.sample_delay_ns() == 0


def test_a_doubled_packet_is_heard_twice():
    radio = Radio()
    assert radio.radio.times == 1
    act(radio.acting, "doubled_packets")
    radio.send(BROADCAST + DRIVE)
    assert radio.heard() == [[DRIVE] * 2] * 2


@pytest.mark.parametrize(
    ("loss", "fault", "to_green", "to_blue", "to_pc"),
    [
        (0.0, None, 0.0, 0.0, 0.0),
        (0.3, None, 0.3, 0.3, 0.3),
        (0.3, {"name": "loss", "share": 0.2}, 0.3, 0.3, 0.3),
        (0.3, {"name": "loss", "share": 0.6}, 0.6, 0.6, 0.6),
        (0.3, {"name": "deaf", "share": 0.9, "robot": "blue"}, 0.3, 0.9, 0.3),
    ],
)
def test_the_worst_of_all_losses_counts_and_a_deaf_robot_is_deaf_alone(
    loss, fault, to_green, to_blue, to_pc
):
    radio = Radio(loss)
    if fault:
        act(radio.acting, fault.pop("name"), **fault)
    assert radio.radio.loss_probability("green") == to_green
    assert radio.radio.loss_probability("blue") == to_blue
    assert radio.radio.loss_probability() == to_pc


def test_as_many_packets_are_lost_as_the_loss_says_each_robot_for_itself():
    radio = Radio(loss=0.25, seed=88)
    for _ in range(1000):
        radio.radio.deliver(DRIVE, 0)
    radio.timeline.run_to(1)
    counts = [len(robot.heard) for robot in radio.robots]
    assert counts == pytest.approx([750, 750], abs=55)  # 4 standard deviations
    assert counts[0] != counts[1]
    nothing = Radio(loss=1.0)
    nothing.send(BROADCAST + DRIVE)
    assert nothing.heard() == [[], []]


def test_another_program_stops_and_drives_all_robots():
    radio = Radio()
    radio.radio.stop_from_other_program(4)
    radio.timeline.run_to(SECOND // 10)
    radio.radio.drive_from_other_program(9, (7, -8))
    radio.timeline.run_to(SECOND)
    green, blue = radio.heard()
    assert green == blue
    stop, drive = (decode_command(FrameSplitter().feed(data)[0]) for data in green)
    assert (stop.sequence, stop.flags) == (4, Flag.EMERGENCY_STOP)
    assert (drive.sequence, drive.flags) == (9, Flag.RUN)
    assert drive.wheels == ((7, -8),) * 4  # robots are numbered up to 3
    assert radio.events == []


def test_the_number_of_our_newest_command_is_known_while_another_program_drives():
    radio = Radio()
    radio.send(BROADCAST + DRIVE)
    assert radio.radio.sequence == 0
    act(radio.acting, "driven_elsewhere", follows=True)
    radio.send(BROADCAST + DRIVE)
    assert radio.radio.sequence == 5
    radio.send(BROADCAST + b"\x03\x11\x22\0")
    assert radio.radio.sequence == 5


def test_a_robots_answer_comes_at_the_program_as_a_received_packet():
    radio = Radio()
    radio.robots[1].answers = [b"fine"]
    radio.radio.poll_answers()
    radio.timeline.run_to(SECOND)
    assert radio.came() == [RECEIVED_HEADER + b"fine"]
    came_ns = radio.written[0][1]
    least_ns = uart_ns(4, ROBOT_BAUD) + (4 + AIR_OVERHEAD_BYTES) * AIR_NS_PER_BYTE
    least_ns += uart_ns(len(encode(RECEIVED_HEADER + b"fine")), BAUD)
    assert least_ns <= came_ns <= least_ns + BACKOFF_MAX_NS
    radio.radio.poll_answers()
    radio.timeline.run_to(2 * SECOND)
    assert len(radio.written) == 1


def test_an_answer_is_tried_four_times_and_each_try_takes_the_air():
    radio = Radio(loss=0.5, seed=7)
    for _ in range(1000):
        radio.robots[0].answers = [b"fine"]
        radio.radio.poll_answers()
        radio.timeline.run_to(radio.timeline.now_ns + SECOND // 10)
    assert len(radio.came()) == pytest.approx(1000 * (1 - 0.5**4), abs=31)
    dead = Radio()
    lost = act(dead.acting, "loss", share=1.0)
    dead.robots[0].answers = [b"fine"]
    dead.radio.poll_answers()
    dead.timeline.run_to(MILLISECOND)
    assert dead.came() == []
    began_ns = dead.timeline.now_ns
    dead.acting.remove(lost)
    dead.send(BROADCAST + DRIVE)
    tries_ns = 4 * ((4 + AIR_OVERHEAD_BYTES) * AIR_NS_PER_BYTE + ACK_NS)
    assert dead.robots[0].heard[0][1] > began_ns + tries_ns - 2 * MILLISECOND


class Plain(RobotRadio):
    """A radio that passes on what robots answer at once."""

    def receive(self, data):
        raise NotImplementedError

    def _decode_command(self, frame):
        raise NotImplementedError


def test_a_plain_radio_sends_each_answer_and_lets_no_other_program_in():
    timeline = Timeline(lambda when_ns: None)
    written = []
    port = SimpleNamespace(name="radio", baud=lambda: BAUD, write=written.append)
    robots = [Robot("green", 0), Robot("blue", 1)]
    radio = Plain(timeline, port, BAUD, None, robots, 0.0, 1)
    robots[1].answers = [b"fine"]
    radio.poll_answers()
    radio.stop_from_other_program(1)
    radio.drive_from_other_program(1, (5, 5))
    timeline.run_to(SECOND)
    assert written == [b"fine"]
    assert robots[0].heard == robots[1].heard == []
