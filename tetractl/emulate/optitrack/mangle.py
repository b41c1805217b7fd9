"""Damaged datagrams, as a fault sends them: none of them is a whole message."""

import random


def mangle(datagram: bytes, chance: random.Random) -> bytes:
    """Return a datagram cut short, grown, with another size in its header, or of noise."""
    match chance.randrange(5):
        case 0:
            return datagram[: chance.randrange(len(datagram))]
        case 1:
            return datagram + bytes(chance.randrange(1, 20))
        case 2:
            return datagram[:2] + (len(datagram) + 7).to_bytes(2, "little") + datagram[4:]
        case 3:  # a count of bodies that cannot be
            return datagram[:8] + b"\xff\xff\xff\x7f" + datagram[12:]
        case _:
            return chance.randbytes(chance.randrange(1, 1400))
