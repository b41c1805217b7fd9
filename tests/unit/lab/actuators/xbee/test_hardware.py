"""Tests of the protocol of an XBee module, and of a port that accepts no more bytes."""

import os
import pty
import tty

import pytest

from tetractl.core.clock import MonotonicClock
from tetractl.core.errors import AbortError
from tetractl.lab.actuators.xbee.hardware import FAMILIES, XbeeSection, find_protocol
from tetractl.lab.actuators.xbee.link import XbeeLink


@pytest.mark.parametrize(
    ("hardware", "version", "runs"),
    [
        (b"\x17\x44", b"\x10\xed", "802.15.4"),
        (b"\x18\x44", b"\x10\xec", "802.15.4"),
        (b"\x22\x44", b"\x20\x03", "802.15.4"),
        (b"\x41\x45", b"\x20\x0d", "802.15.4"),
        (b"\x41\x45", b"\x10\x12", "Zigbee"),
        (b"\x1a\x44", b"\x20\xa7", "Zigbee"),
        (b"\x22\x44", b"\x90\x00", "DigiMesh"),
        (b"\x30\x44", b"\x20\x03", "802.15.4"),  # S2C PRO SMT
        (b"\x52\x44", b"\x20\x14", "802.15.4"),  # XBee RR
        (b"\x57\x44", b"\x20\x14", "802.15.4"),  # XBee RR TH
        (b"\x57\x44", b"\x30\x14", "DigiMesh"),
        (b"\x53\x44", b"\xc0\x01", "802.15.4"),  # S2C P5
        (b"\x53\x44", b"\xb0\x01", "DigiMesh"),
        (b"\x53\x44", b"\x20\x01", "Zigbee"),
        (b"\x23\x44", b"\x20\x03", None),
        (b"\x32\x44", b"\x20\x03", "Zigbee"),  # S2D
        (b"\x19\x44", b"", "Zigbee"),
        (b"\x22\x44", b"", None),
        (b"\xff\x00", b"\x10\x00", None),
        (b"", b"", None),
    ],
)
def test_a_protocol_is_told_by_hardware_and_version(hardware, version, runs):
    assert find_protocol(hardware, version) == runs


def test_a_radio_that_takes_nothing_is_stuck_and_stays_so():
    master, slave = pty.openpty()
    tty.setraw(slave)
    section = XbeeSection(port=os.ttyname(slave))
    link = XbeeLink(section, MonotonicClock())
    try:
        link.open(checked=False)
        with pytest.raises(AbortError, match="the radio is stuck"):
            for _ in range(10_000):
                link.send(bytes(64))
        with pytest.raises(AbortError, match="the radio is stuck"):
            link.send(b"x")
        assert "stuck" in link.failure
    finally:
        link.close()
        os.close(master)
        os.close(slave)


def test_no_hardware_is_of_two_families():
    codes = [code for family, _ in FAMILIES for code in family]
    assert len(codes) == len(set(codes))
