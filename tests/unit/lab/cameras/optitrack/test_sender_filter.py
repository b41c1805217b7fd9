"""Which datagrams come from the camera server, and what is counted of the others."""

import pytest

from tetractl.lab.cameras.optitrack.natnet import MessageKind
from tetractl.lab.cameras.optitrack.sender_filter import REFUSED_SENDERS_MAX, SenderFilter

SERVER = "10.0.0.1"
COMMANDS = 1510


def datagram(kind, more=b""):
    return int(kind).to_bytes(2, "little") + more


FRAME = datagram(MessageKind.FRAME)
ANSWER = datagram(MessageKind.SERVER_INFO)
UNKNOWN = datagram(999)


@pytest.fixture
def senders():
    return SenderFilter(SERVER, COMMANDS)


def test_answers_come_from_the_port_of_commands_alone(senders):
    assert senders.accept(ANSWER, SERVER, COMMANDS)
    assert not senders.accept(ANSWER, SERVER, COMMANDS + 1)
    assert not senders.accept(ANSWER, "10.0.0.2", COMMANDS)


@pytest.mark.parametrize("frame", [FRAME, UNKNOWN, b"\x07"])
def test_frames_come_from_any_port_until_one_is_known(senders, frame):
    assert senders.accept(frame, SERVER, 4000)
    assert senders.accept(frame, SERVER, 5000)
    assert not senders.accept(frame, "10.0.0.2", 4000)
    senders.fix_frames_port(0)
    assert senders.accept(frame, SERVER, 5000)
    senders.fix_frames_port(4000)
    senders.fix_frames_port(5000)  # the first one counts
    assert senders.accept(frame, SERVER, 4000)
    assert not senders.accept(frame, SERVER, 5000)


def test_nothing_is_counted_of_what_is_accepted(senders):
    senders.accept(FRAME, SERVER, 4000)
    senders.accept(ANSWER, SERVER, COMMANDS)
    assert not senders.refused
    assert senders.refused_frame == b""
    for sends_frames in (True, False):
        assert senders.find_main_refused_sender(sends_frames=sends_frames) is None


def test_the_main_refused_sender_is_the_one_of_most_frames_or_answers(senders):
    newest = datagram(MessageKind.FRAME, b"newest")
    for host, count in (("10.0.0.2", 2), ("10.0.0.3", 5), ("10.0.0.4", 3)):
        for _ in range(count):
            senders.accept(FRAME, host, 4000)
    for _ in range(9):
        senders.accept(ANSWER, "10.0.0.5", 4000)
    senders.accept(newest, "10.0.0.4", 4000)
    senders.accept(ANSWER, "10.0.0.4", 4000)
    sender, count = senders.find_main_refused_sender(sends_frames=True)
    assert (str(sender), count) == ("10.0.0.3:4000", 5)
    sender, count = senders.find_main_refused_sender(sends_frames=False)
    assert (str(sender), count) == ("10.0.0.5:4000", 9)
    assert senders.refused_frame == newest


def test_forged_senders_do_not_fill_the_memory_and_known_ones_are_still_counted(senders):
    for port in range(3 * REFUSED_SENDERS_MAX):
        senders.accept(FRAME, "10.0.0.2", port + 1)
    assert len(senders.refused) == REFUSED_SENDERS_MAX
    senders.accept(FRAME, "10.0.0.2", 1)
    assert senders.find_main_refused_sender(sends_frames=True)[1] == 2
