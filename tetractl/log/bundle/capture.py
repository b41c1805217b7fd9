"""Copy a recording of network traffic (a pcap file) with aliases instead of addresses.

UDP and TCP over IPv4 or IPv6 remain, with their payload. Other packets are left out, because they
would show who is in the network: ARP, ICMP, and the services that look up names or assign
addresses.
"""

import ipaddress
import struct
from dataclasses import dataclass

from tetractl.core.errors import UsageError
from tetractl.log.bundle.aliases import Aliases

MAGICS = {
    bytes.fromhex("d4c3b2a1"): "<",
    bytes.fromhex("a1b2c3d4"): ">",
    bytes.fromhex("4d3cb2a1"): "<",  # times in nanoseconds
    bytes.fromhex("a1b23c4d"): ">",
}
"""The first bytes of each kind of capture, with the order of bytes in its headers."""
HEADER = 24
RECORD = 16
ETHERNET = 1
RAW_IP = 101
COOKED = 113
COOKED_2 = 276
"""Type of link, as are the constants above; see https://www.tcpdump.org/linktypes.html."""
IPV4 = 0x0800
IPV6 = 0x86DD
VLAN = 0x8100
TCP = 6
UDP = 17
NAME_PORTS = frozenset({53, 67, 68, 137, 138, 546, 547, 1900, 5353, 5355})
"""Ports of services that look up names or assign addresses. Their packets are left out."""


@dataclass(frozen=True, slots=True)
class AliasedCapture:
    """A recording of network traffic in which aliases replace the addresses.

    Attributes:
        data: The bytes of the file.
        packets: Number of packets in it.
        left_out: Number of packets of the original that were left out.
    """

    data: bytes
    packets: int
    left_out: int


def is_capture(data: bytes) -> bool:
    """Check whether a file is a pcap capture, from its first bytes."""
    return data[:4] in MAGICS


def aliased_capture(data: bytes, aliases: Aliases) -> AliasedCapture:
    """Copy a recording of network traffic, with aliases instead of its addresses.

    An incomplete packet at the end is left out.

    Raises:
        UsageError: If the capture comes from a kind of network that is not known.
    """
    order = MAGICS[data[:4]]
    if len(data) < HEADER:
        raise UsageError("the capture ends within its header")
    link = struct.unpack_from(order + "I", data, 20)[0] & 0x0FFFFFFF
    if link not in (ETHERNET, RAW_IP, COOKED, COOKED_2):
        raise UsageError(
            f"a capture with link type {link} cannot be copied", "capture again with tcpdump -i any"
        )
    copy = bytearray(data[:HEADER])
    packets = left_out = 0
    at = HEADER
    while at + RECORD <= len(data):
        kept = struct.unpack_from(order + "I", data, at + 8)[0]
        end = at + RECORD + kept
        if end > len(data):
            left_out += 1
            break
        packet = _aliased_packet(bytearray(data[at + RECORD : end]), link, aliases)
        if packet is None:
            left_out += 1
        else:
            packets += 1
            copy += data[at : at + RECORD] + aliases.payload(bytes(packet))
        at = end
    return AliasedCapture(bytes(copy), packets, left_out)


def _aliased_packet(packet: bytearray, link: int, aliases: Aliases) -> bytearray | None:
    """Replace the addresses of a packet by aliases. None if the packet has to be left out."""
    try:
        at = _alias_link(packet, link, aliases)
        if at is not None and _alias_ip(packet, at, aliases):
            return packet
    except (struct.error, IndexError, ValueError):  # it is shorter than its headers say
        return None
    return None


def _alias_link(packet: bytearray, link: int, aliases: Aliases) -> int | None:
    """Replace the addresses of network cards, and return where the IP header begins.

    None if the packet has no IP header.
    """
    if link == RAW_IP:
        return 0
    if link == ETHERNET:
        for at in (0, 6):
            packet[at : at + 6] = aliases.mac(bytes(packet[at : at + 6]))
        at = 12
        while _number(packet, at) == VLAN:
            at += 4
        return at + 2 if _number(packet, at) in (IPV4, IPV6) else None
    protocol_at, address_at, end = (14, 6, 16) if link == COOKED else (0, 12, 20)
    packet[address_at : address_at + 6] = aliases.mac(bytes(packet[address_at : address_at + 6]))
    return end if _number(packet, protocol_at) in (IPV4, IPV6) else None


def _alias_ip(packet: bytearray, at: int, aliases: Aliases) -> bool:
    """Replace the IP addresses of a packet, and return whether the packet may remain.

    Only TCP and UDP packets remain, without those of services that look up names.
    """
    if packet[at] >> 4 == 4:
        length, protocol, size, first = (packet[at] & 15) * 4, packet[at + 9], 4, at + 12
        is_later_fragment = bool(_number(packet, at + 6) & 0x1FFF)
    else:
        length, protocol, size, first = 40, packet[at + 6], 16, at + 8
        is_later_fragment = False
    if protocol not in (TCP, UDP):
        return False
    for begin in (first, first + size):
        packet[begin : begin + size] = _aliased_ip(bytes(packet[begin : begin + size]), aliases)
    if size == 4:
        struct.pack_into(">H", packet, at + 10, 0)
        struct.pack_into(">H", packet, at + 10, _checksum(packet[at : at + length]))
    if is_later_fragment:
        return True
    ports = struct.unpack_from(">2H", packet, at + length)
    if protocol == UDP:
        struct.pack_into(">H", packet, at + length + 6, 0)  # no checksum: it covers the addresses
    return NAME_PORTS.isdisjoint(ports)


def _aliased_ip(address: bytes, aliases: Aliases) -> bytes:
    """Return the alias of an IP address that is given as bytes."""
    return ipaddress.ip_address(aliases.ip(str(ipaddress.ip_address(address)))).packed


def _number(packet: bytearray, at: int) -> int:
    return struct.unpack_from(">H", packet, at)[0]


def _checksum(header: bytearray) -> int:
    """Compute the checksum of an IPv4 header (RFC 1071). The header's checksum field must be 0."""
    total = sum(struct.unpack(f">{len(header) // 2}H", header))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return ~total & 0xFFFF
