"""Tests of the link to the radio module: which modules pass, which are refused, what is heard."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.errors import AbortError
from tetractl.lab.actuators.xbee import api_frames as frames
from tetractl.lab.actuators.xbee.hardware import BAUD_RATES, XbeeSection
from tetractl.lab.actuators.xbee.link import XbeeLink

S2C = {b"HV": b"\x21\x00", b"VR": b"\x20\x00", b"BD": b"\x06", b"AP": b"\x02"}
SERIES_1 = S2C | {b"HV": b"\x17\x44", b"VR": b"\x10\xed"}


class Module:
    """Stands for a serial port with an XBee module, which answers each request at once."""

    def __init__(self, answers=S2C, baud=57600, loses=()):
        self.answers = answers
        self.baud = baud
        self.loses = set(loses)
        """Indices of the requests that the module does not receive."""
        self.requests = []
        self.sent = []
        self.failure = None
        self.alone = None
        self.closed = 0
        self.decoder = frames.Decoder()

    def __call__(self, name, baud, device, clock, heard, hint):
        self.heard = heard
        self.set_baud(baud)
        self.clock = clock
        return self

    def open(self, alone=True):
        self.alone = alone

    def set_baud(self, baud):
        self.speed = baud

    def write(self, data):
        for content in self.decoder.feed(data):
            if content[0] != frames.AT_COMMAND:
                self.sent.append(content)
                continue
            command = content[2:]
            is_lost = len(self.requests) in self.loses
            self.requests.append((self.speed, command))
            if not is_lost and self.speed == self.baud and command in self.answers:
                self.answer(content[1], command, self.answers[command])
        return 7

    def answer(self, frame_id, command, value):
        status = 1 if value is None else 0
        head = frames.RESPONSE.pack(frames.AT_RESPONSE, frame_id, command, status)
        self.say(head + (value or b""))

    def say(self, content):
        self.heard(frames.encode(content), self.clock.now())

    def close(self):
        self.closed += 1


def linked(module, baud=57600):
    return XbeeLink(XbeeSection(port="radio", baud=baud), VirtualClock(), module)


def refusal(module, baud=57600):
    with pytest.raises(AbortError) as caught:
        linked(module, baud).open()
    return caught.value.message


@pytest.mark.parametrize("answers", [S2C, SERIES_1])
@pytest.mark.parametrize("baud", BAUD_RATES[3:7])
def test_a_module_with_the_right_firmware_passes_without_a_question(answers, baud):
    answers = answers | {b"BD": bytes([BAUD_RATES.index(baud)])}
    link = linked(Module(answers, baud), baud)
    link.open()
    assert link.questions == ()


def test_the_port_is_opened_as_exclusively_as_asked_and_an_unchecked_module_is_left_alone():
    for alone in (True, False):
        module = Module({})
        linked(module).open(checked=False, exclusive=alone)
        assert module.alone is alone
        assert module.requests == []


def test_a_module_of_an_unknown_kind_is_a_question():
    link = linked(Module(S2C | {b"HV": b"\x77\x01", b"VR": b"\x20\x11"}))
    link.open()
    (question,) = link.questions
    assert "HV 7701, VR 2011" in question


def test_a_module_that_does_not_tell_its_firmware_is_a_question_if_it_may_have_several():
    for value in ({}, {b"VR": None}):
        answers = {key: S2C[key] for key in (b"HV", b"BD", b"AP")} | value
        link = linked(Module(answers))
        link.open()
        assert "VR not reported" in link.questions[0]


@pytest.mark.parametrize(
    ("answers", "named", "cure"),
    [
        (S2C | {b"VR": b"\x90\x00"}, "DigiMesh", "load 802.15.4 firmware"),
        (S2C | {b"VR": b"\x40\x00"}, "Zigbee", "load 802.15.4 firmware"),
        (S2C | {b"HV": b"\x19\x00"}, "Zigbee", "use a module that has"),
        (S2C | {b"HV": b"\x19\x00", b"VR": None}, "Zigbee", "use a module that has"),
        (SERIES_1 | {b"VR": b"\x80\x00"}, "DigiMesh", "load 802.15.4 firmware"),
    ],
)
def test_a_module_with_the_wrong_firmware_is_refused_with_its_cure(answers, named, cure):
    with pytest.raises(AbortError, match=f"runs {named} firmware") as caught:
        linked(Module(answers)).open()
    assert cure in caught.value.hint


@pytest.mark.parametrize("code", [3, 4, 5, 7])
def test_a_module_that_keeps_another_speed_than_the_spec_is_refused(code):
    text = refusal(Module(S2C | {b"BD": b"\0\0\0" + bytes([code])}))
    assert f"set to {BAUD_RATES[code]} baud, but the spec says 57600" in text


@pytest.mark.parametrize("value", [None, b"\x01\xc2\x00", b"\x08"])
def test_a_speed_that_is_in_no_table_is_not_a_reason_to_refuse(value):
    linked(Module(S2C | {b"BD": value})).open()


@pytest.mark.parametrize("mode", [0, 1, 3])
def test_a_module_in_another_mode_is_refused(mode):
    assert "not in API mode with escapes" in refusal(Module(S2C | {b"AP": bytes([mode])}))


def test_a_module_that_falls_silent_is_refused_as_that():
    answers = {key: S2C[key] for key in (b"HV", b"VR", b"BD")}
    assert "does not answer any more" in refusal(Module(answers))


def test_an_old_module_at_the_highest_speed_is_refused_and_a_newer_one_is_not():
    at_7 = {b"BD": b"\x07"}
    assert "Series 1" in refusal(Module(SERIES_1 | at_7, 115_200), 115_200)
    linked(Module(S2C | at_7, 115_200), 115_200).open()


def test_hardware_and_mode_are_requested_again_if_a_request_is_lost():
    module = Module(loses=[0])
    linked(module).open()
    commands = [command for _, command in module.requests]
    assert commands == [b"HV", b"HV", b"VR", b"BD", b"AP"]
    module = Module(loses=[3])
    linked(module).open()
    assert [command for _, command in module.requests] == [b"HV", b"VR", b"BD", b"AP", b"AP"]


@pytest.mark.parametrize("baud", [9600, 38400, 115_200])
def test_the_speed_at_which_a_silent_module_answers_is_named(baud):
    module = Module(baud=baud)
    assert f"answers at {baud} baud, but the spec says 57600" in refusal(module)
    tried = [speed for speed, _ in module.requests]
    assert tried[:2] == [57600, 57600] and tried[-1] == 57600
    assert tried[2:-1] == [each for each in BAUD_RATES[3:] if each != 57600 and each <= baud]


def test_a_port_without_a_module_is_tried_at_every_speed_that_a_spec_may_state():
    module = Module({})
    assert "no XBee module answers at 57600 baud or any other" in refusal(module)
    assert [speed for speed, _ in module.requests] == [
        *(57600, 57600),
        *(9600, 19200, 38400, 115_200),
        57600,
    ]


def test_a_module_that_wakes_late_is_no_module_at_another_speed():
    module = Module(loses=range(6))
    linked(module).open()
    assert [command for _, command in module.requests][-3:] == [b"VR", b"BD", b"AP"]


def test_a_request_takes_three_tenths_of_a_second_at_most_and_none_if_it_is_answered():
    module = Module()
    link = linked(module)
    assert link.request(b"HV") == b"\x21\x00"
    assert module.clock.now() == 0
    assert link.request(b"XX") is None
    assert module.clock.now() == pytest.approx(0.3 * SECOND, rel=0.02)


def test_only_the_answer_to_the_last_request_counts():
    module = Module({})
    link = linked(module)
    module.answer(1, b"HV", b"early")
    assert link.request(b"HV") is None, "it came before the request"
    write = module.write

    def answering(data):
        module.answer(9, b"HV", b"another request")
        module.answer(2, b"VR", b"another parameter")
        return write(data)

    module.write = answering
    assert link.request(b"HV") is None


def test_an_error_of_the_module_is_an_answer_without_a_value():
    module = Module({b"HV": None})
    assert linked(module).request(b"HV") is None
    assert module.clock.now() == 0


def test_request_numbers_are_from_1_to_255():
    """A module does not answer requests of number 0."""
    module = Module()
    link = linked(module)
    assert all(link.request(b"AP") == b"\x02" for _ in range(600))


def test_data_is_broadcast_to_all_modules():
    module = Module()
    link = linked(module)
    assert link.send(b"hello") == 7
    assert module.sent == [frames.BROADCAST + b"hello"]


@given(st.lists(st.binary(min_size=1, max_size=20), max_size=5))
def test_data_of_other_modules_is_fetched_once_in_order(messages):
    module = Module()
    link = linked(module)
    for message in messages:
        module.say(b"\x81\x12\x34\x28\0" + message)
    module.say(b"\x81\x12\x34\x28\0")  # without data
    module.say(b"\x8a\x00")  # a status of the module
    assert link.fetch() == messages
    assert link.fetch() == []


def test_a_wait_ends_with_data_or_a_failure_or_its_time():
    module = Module()
    link = linked(module)
    link.wait(0.5)
    assert module.clock.now() == pytest.approx(0.5 * SECOND, rel=0.02)
    before_ns = module.clock.now()
    module.say(b"\x81\x12\x34\x28\0hello")
    link.wait(0.5)
    link.fetch()
    module.failure = "the port is gone"
    link.wait(0.5)
    assert module.clock.now() == before_ns
    assert link.failure == "the port is gone"


def test_closing_the_link_closes_the_port():
    module = Module()
    linked(module).close()
    assert module.closed == 1
