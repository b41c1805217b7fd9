import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.core.errors import WireError
from tetractl.emulate.m3pi.robot import SIGNATURE, SlaveProgram
from tetractl.lab.actuators.m3pi.slave import (
    BATTERY_REQUEST,
    SIGNATURE_REQUEST,
    STOP,
    decode_battery,
    encode_wheels,
)

counts = st.integers(-127, 127)


def test_documented_bytes():
    assert encode_wheels(64, -127) == bytes.fromhex("C1 40 C6 7F")
    assert encode_wheels(-1, 5) == bytes.fromhex("C2 01 C5 05")
    assert encode_wheels(0, 0) == STOP
    assert SIGNATURE_REQUEST + BATTERY_REQUEST == b"\x81\xb1"
    assert decode_battery(b"\x39\x15") == 5433


def test_a_lost_data_byte_costs_that_command_only():
    program = SlaveProgram()
    program.hear(b"\xc1" + encode_wheels(3, 4)[2:], 0, 0)
    assert program.counts(0) == (0, 4)
    program.hear(SIGNATURE_REQUEST + b"\x05\xba", 0, 0)
    assert (program.counts(0), program.answer(0)) == ((0, 0), SIGNATURE)
    assert program.ignored == 3  # the command without data, data without command, a calibration


@given(st.binary(max_size=50), counts, counts)
def test_resynchronises_after_any_garbage(garbage, left, right):
    program = SlaveProgram()
    program.hear(garbage, 0, 0)
    program.hear(encode_wheels(left, right), 0, 0)
    assert program.counts(0) == (left, right)


@pytest.mark.parametrize("bad", [(-128, 0), (0, 128)])
def test_counts_outside_are_refused(bad):
    with pytest.raises(WireError):
        encode_wheels(*bad)
    with pytest.raises(WireError):
        decode_battery(b"\0")
