"""Tests of the bytes between the host and the current driver."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit.codec_checks import ANY_BYTES, check_any_bytes, check_round_trip
from testkit.device_replies import packed_reply
from testkit.paths import ROOT
from tetractl_emulator.virtual_lab import LabClock
from tetractl_microscope.coils import driver
from tetractl_microscope.coils.driver import DriverStatus, FieldCommand, FieldReply

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.errors import WireError
from tetractl.lab import cobs
from tetractl.lab.cobs import Flag

COILS = FieldCommand(7, Flag.RUN | Flag.POLL, 300, -250)
DRIVER = FieldReply(7, DriverStatus.RUNNING, 1, 299, -250, 12_040, 253, 412, 0, 2000, 20_000, 250)

i16 = st.integers(-32_768, 32_767)
u8 = st.integers(0, 255)
u16 = st.integers(0, 65_535)
commands = st.builds(FieldCommand, u8, st.integers(0, 7).map(Flag), i16, i16)
replies = st.builds(
    FieldReply,
    u8,
    st.integers(0, 31).map(DriverStatus),
    *(u8, i16, i16, u16, i16, u16, u16, u16, st.integers(0, 2**32 - 1), u16),
)
each_message = pytest.mark.parametrize(
    ("encode", "decode", "messages"),
    [
        (driver.encode_command, driver.decode_command, commands),
        (packed_reply, driver.decode_reply, replies),
    ],
)


@pytest.mark.parametrize(
    ("frame", "size"), [(driver.encode_command(COILS), 11), (packed_reply(DRIVER), 28)]
)
def test_the_documented_bytes_are_those_sent(frame, size):
    page = (ROOT / "docs" / "reference" / "wires.md").read_text()
    on_one_line = " ".join(page.split())
    assert frame.hex(" ").upper() in on_one_line
    assert len(frame) == size


@each_message
@given(data=st.data())
def test_messages_round_trip_and_every_bit_error_is_detected(encode, decode, messages, data):
    check_round_trip(encode, decode, data.draw(messages))


@each_message
@given(raw=ANY_BYTES)
def test_any_bytes_are_a_message_or_refused(encode, decode, messages, raw):
    check_any_bytes(encode, decode, raw)


@pytest.mark.parametrize(
    "message",
    [
        FieldCommand(256, Flag.RUN),
        FieldCommand(-1, Flag.RUN),
        FieldCommand(0, Flag.RUN, 32_768, 0),
        FieldCommand(0, Flag.RUN, 0, -32_769),
        FieldCommand(0, Flag(8)),
    ],
)
def test_what_does_not_fit_is_not_encoded(message):
    with pytest.raises(WireError):
        driver.encode_command(message)


def test_an_answer_to_an_earlier_poll_is_none_to_the_newest():
    sent = []  # numbers of the polls
    clock = LabClock()

    class LateDriver:
        """A port whose driver answers each poll only after the next one."""

        failure = None

        def __init__(self, link, baud, device, clock, heard, *hints):
            self.heard = heard
            self.unanswered = []
            clock.steps.append(self.answer)

        def write(self, frame):
            if sent:
                self.unanswered.append(sent[-1])
            sent.append(driver.decode_command(frame[:-1]).sequence)
            return 0

        def answer(self):
            while self.unanswered:
                reply = replace(DRIVER, sequence=self.unanswered.pop())
                self.heard(packed_reply(reply), 0)

    assert driver.Driver("coils", 115_200, clock, LateDriver).ask() is None
    assert len(sent) == 5


def test_an_unknown_flag_with_a_good_crc_is_refused():
    with pytest.raises(WireError):
        driver.decode_command(cobs.encode_with_crc(bytes.fromhex("53 01 08 00 00 00 00"))[:-1])


def test_unknown_status_bits_of_a_driver_are_dropped():
    raw = bytearray(cobs.decode(packed_reply(DRIVER)[:-1])[:-2])
    raw[2] |= 0xE0
    assert driver.decode_reply(cobs.encode_with_crc(bytes(raw))[:-1]) == DRIVER


class SilentPort:
    """A port to which commands are written, and whose driver answers when a test says so."""

    failure = None

    def __init__(self, link, baud, device, clock, heard, *hints):
        self.clock = clock
        self.heard = heard
        self.sent = []

    def write(self, frame):
        self.sent.append(driver.decode_command(frame[:-1]))
        return self.clock.now()


def sent_to(commands, every_ms):
    """A driver that answers none of some commands."""
    clock = VirtualClock()
    coils = driver.Driver("coils", 115_200, clock, SilentPort)
    for _ in range(commands):
        coils.send(Flag.RUN)
        clock.sleep_until(clock.now() + every_ms * SECOND // 1000)
    return coils, clock


@pytest.mark.parametrize(
    ("commands", "every_ms", "fails"),
    [
        (0, 1000, False),
        (5, 1000, False),  # replies to a few rare commands may be lost
        (20, 20, False),  # replies may be late
        (6, 90, True),
        (6, 80, False),
        (30, 20, True),
    ],
)
def test_a_driver_is_silent_after_six_commands_and_half_a_second(commands, every_ms, fails):
    coils, clock = sent_to(commands, every_ms)
    assert (coils.failure is not None) is fails
    coils._port.heard(packed_reply(DRIVER), clock.now())
    assert coils.failure is None
    coils.send(Flag.RUN)
    clock.sleep_until(clock.now() + SECOND)
    assert coils.failure is None


def test_an_emergency_stop_is_repeated_in_all_later_commands_and_reported():
    coils, clock = sent_to(1, 10)
    coils.send(Flag.RUN | Flag.EMERGENCY_STOP, 100, -50)
    coils.send(Flag.RUN, 100, -50)
    flags = [command.flags for command in coils._port.sent]
    assert [bool(flag & Flag.EMERGENCY_STOP) for flag in flags] == [False, True, True]
    assert all(flag & Flag.POLL for flag in flags)
    assert (coils._port.sent[-1].x_ma, coils._port.sent[-1].y_ma) == (100, -50)
    numbers = [command.sequence for command in coils._port.sent]
    assert numbers[1] == (numbers[0] + 1) % 256 and numbers[2] == (numbers[1] + 1) % 256
    assert not coils.is_emergency_stopped
    stopped = replace(DRIVER, status=DriverStatus.EMERGENCY_STOPPED)
    coils._port.heard(packed_reply(stopped), clock.now())
    assert coils.is_emergency_stopped
    assert coils.failure == "the current driver is emergency-stopped"
