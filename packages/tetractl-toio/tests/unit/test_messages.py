"""Tests of messages against the published specification and the manufacturer's library."""

import pytest
from tetractl_toio import messages
from tetractl_toio.messages import Characteristic, CubeReading

from tetractl.core.errors import WireError

POSITION = bytes.fromhex("01 c502 7f01 3201 bc02 8201 3201")  # the specification's example
DRIVE = bytes.fromhex("02 01 01 64 02 02 14 0a")  # left forward 100, right backward 20, 100 ms


def test_the_examples_of_the_specification_are_read_and_written():
    assert messages.decode_reading(POSITION) == CubeReading(709, 383, 306)
    assert messages.decode_reading(b"\x03") is None
    assert messages.decode_reading(bytes.fromhex("02 00003800 1500")) is None  # a card
    assert messages.encode_motor(100, -20, 100) == DRIVE
    assert messages.decode_motor(DRIVE) == (100, -20, 100)
    assert messages.decode_motor(b"\x01" + DRIVE[1:7]) == (100, -20, 0)
    assert bytes.fromhex("18 00 01 00") == messages.NOTIFY_READINGS
    assert bytes.fromhex("19 00 01") == messages.NOTIFY_MISSED
    assert not messages.is_refusal(bytes.fromhex("98 00 00"))
    assert messages.is_refusal(bytes.fromhex("98 00 01"))
    assert Characteristic.ID.uuid == "10b20101-5b3b-4571-9508-cf3efcd7bbae"
    assert Characteristic.CONFIGURATION.uuid == "10b201ff-5b3b-4571-9508-cf3efcd7bbae"


@pytest.mark.parametrize("index, value", [(0, 3), (1, 0), (1, 2), (2, 0), (5, 3), (4, 1)])
def test_motor_commands_that_a_cube_ignores_are_refused(index, value):
    command = bytearray(DRIVE)
    command[index] = value
    with pytest.raises(WireError):
        messages.decode_motor(bytes(command))
    with pytest.raises(ValueError, match="motor speeds"):
        messages.encode_motor(116, 0, 250)


def test_messages_cross_a_port_in_any_pieces():
    values = (POSITION, b"\x03", b"")
    stream = b"".join(messages.pack(Characteristic.ID, value) for value in values)
    for size in (1, 3, len(stream)):
        unpacker = messages.Unpacker()
        pieces = [stream[i : i + size] for i in range(0, len(stream), size)]
        unpacked = []
        for piece in pieces:
            unpacked += unpacker.feed(piece)
        assert unpacked == [(1, value) for value in values]


def test_the_makers_library_reads_and_writes_the_same():
    """toio.py of PyPI, the second witness."""
    ids = pytest.importorskip("toio.cube.api.id_information", reason="toio-py is not installed")
    motor = pytest.importorskip("toio.cube.api.motor")
    setting = pytest.importorskip("toio.cube.api.configuration")
    readings = CubeReading(45, 455, 0), CubeReading(709, 383, 306), CubeReading(65_535, 0, 359)
    for reading in readings:
        theirs = ids.IdInformation.is_my_data(bytearray(messages.encode_reading(reading)))
        assert (theirs.center.point.x, theirs.center.point.y) == (reading.x, reading.y)
        assert theirs.center.angle == reading.angle
    missed = ids.IdInformation.is_my_data(bytearray(messages.encode_reading(None)))
    assert isinstance(missed, ids.PositionIdMissed)
    for command in ((100, -20, 100), (0, 0, 250), (-115, 8, 2550)):
        assert messages.encode_motor(*command) == bytes(motor.MotorControl(*command))
    always = setting.NotificationCondition.Always
    assert bytes(setting.SetIdNotification(10, always)) == messages.NOTIFY_READINGS
    assert bytes(setting.SetIdMissedNotification(10)) == messages.NOTIFY_MISSED
