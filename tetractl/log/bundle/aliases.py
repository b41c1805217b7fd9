"""Replace addresses and names in texts and network packets by aliases.

The aliases of addresses come from ranges that are reserved for documentation: 192.0.2.0/24,
2001:db8::/32, 00:00:5e:00:53:00, and the domain `example`. A spec with aliases therefore remains
valid. Addresses that identify nobody stay: loopback, broadcast and multicast.

    aliases = Aliases(["Ada"])
    aliases.alias_text("Ada's tracker: 192.168.1.5")      "removed-1's tracker: 192.0.2.1"
    aliases.alias_text("192.168.1.5, 192.168.1.6")        "192.0.2.1, 192.0.2.2"
"""

import ipaddress
import re
from collections import Counter
from collections.abc import Iterable

IPV4_MAX = 254
"""Maximum number of different IPv4 aliases. All further addresses share the last alias."""
VERSION_BELOW = 10
"""Bound of the first of four numbers.

Below this bound, the four numbers count as a version, and not as an IPv4 address.
"""
IP_HEX = re.compile(r"(?<![\w:.])[0-9A-Fa-f]{0,4}(?::[0-9A-Fa-f]{0,4}){2,7}(?![\w:])")
IP_DOTTED = re.compile(r"(?<![\w.])\d{1,3}(?:\.\d{1,3}){3}(?![\w]|\.\d)")
MAC = re.compile(
    r"(?<![\w:-])[0-9A-Fa-f]{2}(?:([:-])[0-9A-Fa-f]{2})(?:\1[0-9A-Fa-f]{2}){4}(?![\w:-])"
)
XBEE = re.compile(r"(?<!\w)0013[Aa]2[0-9A-Fa-f]{2} ?[0-9A-Fa-f]{8}(?!\w)")
LOGIN = re.compile(r"(?<=://)[^/\s@]+@")
PERSON = re.compile(r"(?<![\w.+-])[\w.+-]+@[\w-]+(?:\.[\w-]+)*")
HOST = re.compile(r"(?<=://)(?!localhost\b)[A-Za-z][\w.-]*\w")
HOME = re.compile(r"((?:/|\b[A-Za-z]:\\)(?:home|Users)[/\\])[^/\\\s\"':]+")
ORDINARY_WORD = re.compile(r"[a-z]+")


class Aliases:
    """A mapping from addresses and names to aliases. The same name always gets the same alias.

    Args:
        names: Names to replace, also as a part of a word, in upper and lower case.
    """

    def __init__(self, names: Iterable[str] = ()) -> None:
        self._names = sorted((name for name in names if name), key=len, reverse=True)
        self._aliases: dict[tuple[str, str], str] = {}
        self.counts = Counter[str]()
        """Number of different addresses and names that were replaced, by kind."""

    def alias_text(self, text: str) -> str:
        """Replace the addresses and names in a text by aliases."""
        text = LOGIN.sub("", text)
        text = PERSON.sub(lambda m: self._alias("persons", m[0], "person-{}@example.org"), text)
        text = MAC.sub(lambda m: self._mac_in_text(m[0]), text)
        text = XBEE.sub(
            lambda m: self._alias("radios", m[0].replace(" ", ""), "0013A20000{:06X}"), text
        )
        text = IP_HEX.sub(lambda m: self.alias_ip(m[0]), text)
        text = IP_DOTTED.sub(lambda m: m[0] if _is_version(m[0]) else self.alias_ip(m[0]), text)
        text = HOST.sub(lambda m: self._alias("hosts", m[0], "host-{}.example"), text)
        text = HOME.sub(r"\1user", text)
        for name in self._names:
            pattern = re.compile(re.escape(name), re.IGNORECASE)
            if pattern.search(text):
                text = pattern.sub(self._alias("names", name.casefold(), "removed-{}"), text)
        return text

    def mask_payload(self, data: bytes) -> bytes:
        """Overwrite each name in the payload of a packet with x, so that its length stays the same.

        Addresses are not replaced.
        """
        for name in self._names:
            pattern = re.compile(re.escape(name.encode()), re.IGNORECASE)
            data = pattern.sub(lambda m: b"x" * len(m[0]), data)
        return data

    def add_host_name(self, name: str) -> None:
        """Add a computer's name to the names that later texts must not contain.

        An ordinary word of small letters, such as `lab`, is not replaced.
        """
        if name and ORDINARY_WORD.fullmatch(name) is None and name not in self._names:
            self._names.append(name)

    def alias_ip(self, address: str) -> str:
        """Return the alias of an IPv4 or IPv6 address.

        A string that is no address is returned unchanged, and so are loopback, multicast,
        broadcast and unspecified addresses.
        """
        try:
            parsed = ipaddress.ip_address(address)
        except ValueError:
            return address
        if parsed.is_loopback or parsed.is_multicast or parsed.is_unspecified:
            return address
        if isinstance(parsed, ipaddress.IPv6Address):
            return self._alias("addresses", parsed.compressed, "2001:db8::{:x}")
        if address == "255.255.255.255":
            return address
        return self._alias("addresses", address, "192.0.2.{}", IPV4_MAX)

    def alias_mac(self, address: bytes) -> bytes:
        """Return the alias of a MAC address, given as 6 bytes.

        Multicast and broadcast addresses, and the address of zeros, are returned unchanged.
        """
        if address[0] & 1 or not any(address):  # multicast, broadcast or none
            return address
        alias = self._alias("network cards", address.hex(), "00005e0053{:02x}", 255)
        return bytes.fromhex(alias)

    def _mac_in_text(self, text: str) -> str:
        separator = text[2]
        alias = self.alias_mac(bytes.fromhex(text.replace(separator, "")))
        return alias.hex(separator)

    def _alias(self, category: str, original: str, pattern: str, number_max: int = 1 << 24) -> str:
        """Return the alias of an address or name. Create the alias if it does not exist yet.

        Args:
            category: Kind of the original, such as "hosts". Aliases are numbered per category.
            original: The address or name to replace.
            pattern: Format of the alias, into which the number is filled.
            number_max: Maximum number. All further originals share the alias with this number.
        """
        if (category, original) not in self._aliases:
            self.counts[category] += 1
            number = min(self.counts[category], number_max)
            self._aliases[category, original] = pattern.format(number)
        return self._aliases[category, original]


def _is_version(text: str) -> bool:
    """Check whether four numbers look like a version, such as 4.1.0.0, and not like an address."""
    return int(text.partition(".")[0]) < VERSION_BELOW
