"""Tests of copying captures: addresses get aliases, and the content of packets stays."""

import ipaddress
import struct

import pytest

from tetractl.core.errors import UsageError
from tetractl.log.bundle.aliases import Aliases
from tetractl.log.bundle.capture import alias_capture, is_capture

CARDS = bytes.fromhex("a0b1c2d3e4f5 102030405060".replace(" ", ""))
PAYLOAD = b"frame 1 of Ada"
ETHERNET, RAW_IP, COOKED, COOKED_2 = 1, 101, 113, 276


def udp(source, destination, port=1511, payload=PAYLOAD):
    addresses = [ipaddress.ip_address(text) for text in (source, destination)]
    body = struct.pack(">4H", 1510, port, 8 + len(payload), 0xBEEF) + payload
    packed = b"".join(address.packed for address in addresses)
    if addresses[0].version == 6:
        return struct.pack(">IHBB", 6 << 28, len(body), 17, 64) + packed + body
    return struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(body), 1, 0, 64, 17, 0xDEAD) + packed + body


def framed(link, packet, protocol=None):
    if protocol is None:
        protocol = 0x0800 if packet[0] >> 4 == 4 else 0x86DD
    number = struct.pack(">H", protocol)
    match link:
        case 1:
            return CARDS + number + packet
        case 113:
            return struct.pack(">3H", 0, 1, 6) + CARDS[:6] + bytes(2) + number + packet
        case 276:
            return number + bytes(6) + bytes(4) + CARDS[:6] + bytes(2) + packet
    return packet


def capture(link, *packets, order="<"):
    magic = struct.pack(order + "I", 0xA1B2C3D4)
    header = magic + struct.pack(order + "HHiIII", 2, 4, 0, 0, 65535, link)
    records = (struct.pack(order + "4I", 5, 6, len(p), len(p)) + p for p in packets)
    return header + b"".join(records)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("link", [ETHERNET, RAW_IP, COOKED, COOKED_2])
def test_addresses_get_aliases_and_the_content_stays(link, order):
    original = capture(link, framed(link, udp("192.168.1.5", "239.255.42.99")), order=order)
    copy = alias_capture(original, Aliases())
    assert (copy.packets, copy.left_out) == (1, 0)
    assert len(copy.data) == len(original) and copy.data[:40] == original[:40]
    assert ipaddress.ip_address("192.168.1.5").packed not in copy.data
    both = [ipaddress.ip_address(text).packed for text in ("192.0.2.1", "239.255.42.99")]
    assert b"".join(both) in copy.data and PAYLOAD in copy.data
    assert CARDS[:6] not in copy.data and CARDS[6:] not in copy.data


def test_the_checksum_of_an_ipv4_header_is_right():
    packet = alias_capture(capture(RAW_IP, udp("192.168.1.5", "10.0.0.7")), Aliases()).data[40:]
    total = sum(struct.unpack(">10H", packet[:20]))
    assert (total & 0xFFFF) + (total >> 16) == 0xFFFF
    assert packet[26:28] == b"\0\0"  # UDP: none


def test_ipv6_addresses_get_aliases():
    copy = alias_capture(capture(RAW_IP, udp("fe80::5", "ff02::1")), Aliases()).data
    both = [ipaddress.ip_address(text).packed for text in ("2001:db8::1", "ff02::1")]
    assert b"".join(both) in copy


def test_packets_that_say_who_is_there_are_left_out():
    arp = framed(ETHERNET, bytes(28), 0x0806)
    lookup = framed(ETHERNET, udp("192.168.1.5", "10.0.0.7", port=53))
    ping = bytearray(framed(ETHERNET, udp("192.168.1.5", "10.0.0.7")))
    ping[14 + 9] = 1
    cut = framed(ETHERNET, udp("192.168.1.5", "10.0.0.7"))[:20]
    good = framed(ETHERNET, udp("192.168.1.5", "10.0.0.7"))
    copy = alias_capture(capture(ETHERNET, arp, lookup, bytes(ping), cut, good), Aliases())
    assert (copy.packets, copy.left_out) == (1, 4)


def test_names_in_packets_are_crossed_out():
    original = capture(RAW_IP, udp("192.168.1.5", "10.0.0.7"))
    assert b"frame 1 of xxx" in alias_capture(original, Aliases(["ada"])).data


@pytest.mark.parametrize("end", range(24, 80, 7))
def test_a_capture_that_is_cut_off_keeps_its_whole_packets(end):
    original = capture(RAW_IP, udp("192.168.1.5", "10.0.0.7", payload=b"")) * 1
    copy = alias_capture(original[:end], Aliases())
    assert copy.packets == (end >= len(original))


def test_captures_that_cannot_be_copied_are_refused():
    assert not is_capture(bytes.fromhex("0a0d0d0a"))  # pcapng
    with pytest.raises(UsageError, match="link type 105"):
        alias_capture(capture(105), Aliases())
    with pytest.raises(UsageError, match="the capture ends within"):
        alias_capture(capture(ETHERNET)[:10], Aliases())
