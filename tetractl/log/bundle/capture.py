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
HEADER_SIZE = 24
"""Size of the header of a capture [bytes]."""
RECORD_HEADER_SIZE = 16
"""Size of the header of each packet in a capture [bytes]."""
ETHERNET = 1
RAW_IP = 101
COOKED = 113
COOKED_2 = 276
"""The last of four link types of a capture; see https://www.tcpdump.org/linktypes.html."""
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
        packets: Number of packets in the copy.
        left_out: Number of packets of the original that were left out.
    """

    data: bytes
    packets: int
    left_out: int


def is_capture(data: bytes) -> bool:
    """Check whether a file is a pcap capture, from its first bytes."""
    return data[:4] in MAGICS


def alias_capture(data: bytes, aliases: Aliases) -> AliasedCapture:
    """Copy a recording of network traffic, with aliases instead of its addresses.

    An incomplete packet at the end is left out.

    Raises:
        UsageError: If the capture comes from a kind of network that is not known.
    """
    byte_order = MAGICS[data[:4]]
    if len(data) < HEADER_SIZE:
        raise UsageError("the capture ends within its header")
    link_type = struct.unpack_from(byte_order + "I", data, 20)[0] & 0x0FFFFFFF
    if link_type not in (ETHERNET, RAW_IP, COOKED, COOKED_2):
        raise UsageError(
            f"a capture with link type {link_type} cannot be copied",
            "capture again with tcpdump -i any",
        )
    copy = bytearray(data[:HEADER_SIZE])
    packets = left_out = 0
    offset = HEADER_SIZE
    while offset + RECORD_HEADER_SIZE <= len(data):
        length = struct.unpack_from(byte_order + "I", data, offset + 8)[0]
        end = offset + RECORD_HEADER_SIZE + length
        if end > len(data):
            left_out += 1
            break
        packet = _alias_packet(
            bytearray(data[offset + RECORD_HEADER_SIZE : end]), link_type, aliases
        )
        if packet is None:
            left_out += 1
        else:
            packets += 1
            copy += data[offset : offset + RECORD_HEADER_SIZE] + aliases.mask_payload(bytes(packet))
        offset = end
    return AliasedCapture(bytes(copy), packets, left_out)


def _alias_packet(packet: bytearray, link_type: int, aliases: Aliases) -> bytearray | None:
    """Replace the addresses of a packet by aliases.

    Returns:
        The packet, which is changed in place. None if it has to be left out.
    """
    try:
        ip_offset = _alias_link(packet, link_type, aliases)
        if ip_offset is not None and _alias_ip(packet, ip_offset, aliases):
            return packet
    except (struct.error, IndexError, ValueError):  # it is shorter than its headers say
        return None
    return None


def _alias_link(packet: bytearray, link_type: int, aliases: Aliases) -> int | None:
    """Replace the addresses of network cards in a packet by aliases.

    Returns:
        Where the IP header begins. None if the packet has none.
    """
    if link_type == RAW_IP:
        return 0
    if link_type == ETHERNET:
        for offset in (0, 6):
            packet[offset : offset + 6] = aliases.alias_mac(bytes(packet[offset : offset + 6]))
        offset = 12
        while _read_u16(packet, offset) == VLAN:
            offset += 4
        return offset + 2 if _read_u16(packet, offset) in (IPV4, IPV6) else None
    protocol_offset, address_offset, header_size = (
        (14, 6, 16) if link_type == COOKED else (0, 12, 20)
    )
    packet[address_offset : address_offset + 6] = aliases.alias_mac(
        bytes(packet[address_offset : address_offset + 6])
    )
    return header_size if _read_u16(packet, protocol_offset) in (IPV4, IPV6) else None


def _alias_ip(packet: bytearray, offset: int, aliases: Aliases) -> bool:
    """Replace the IP addresses of a packet by aliases.

    Args:
        packet: The packet, which is changed in place.
        offset: Where its IP header begins.
        aliases: The aliases of addresses.

    Returns:
        Whether the packet may remain: only TCP and UDP packets do, and only if they do not belong
        to a service that looks up names or assigns addresses.
    """
    if packet[offset] >> 4 == 4:
        header_size = (packet[offset] & 15) * 4
        protocol = packet[offset + 9]
        address_size = 4
        source = offset + 12
        is_later_fragment = bool(_read_u16(packet, offset + 6) & 0x1FFF)
    else:
        header_size = 40
        protocol = packet[offset + 6]
        address_size = 16
        source = offset + 8
        is_later_fragment = False
    if protocol not in (TCP, UDP):
        return False
    destination = source + address_size
    for begin in (source, destination):
        end = begin + address_size
        packet[begin:end] = _alias_address(bytes(packet[begin:end]), aliases)
    if address_size == 4:
        struct.pack_into(">H", packet, offset + 10, 0)
        checksum = _checksum(packet[offset : offset + header_size])
        struct.pack_into(">H", packet, offset + 10, checksum)
    if is_later_fragment:
        return True
    ports = struct.unpack_from(">2H", packet, offset + header_size)
    if protocol == UDP:
        # 0 means no checksum: the checksum of UDP covers the addresses, too
        struct.pack_into(">H", packet, offset + header_size + 6, 0)
    return NAME_PORTS.isdisjoint(ports)


def _alias_address(address: bytes, aliases: Aliases) -> bytes:
    """Return the alias of an IP address that is given as bytes."""
    return ipaddress.ip_address(aliases.alias_ip(str(ipaddress.ip_address(address)))).packed


def _read_u16(packet: bytearray, offset: int) -> int:
    return struct.unpack_from(">H", packet, offset)[0]


def _checksum(header: bytearray) -> int:
    """Compute the checksum of an IPv4 header (RFC 1071). The header's checksum field must be 0."""
    checksum = sum(struct.unpack(f">{len(header) // 2}H", header))
    while checksum >> 16:
        checksum = (checksum & 0xFFFF) + (checksum >> 16)
    return ~checksum & 0xFFFF
