"""XBee hardware and firmware versions, and the section of the module in a spec.

The first byte of HV (hardware version) gives the hardware, and the first hexadecimal digit of VR
(firmware version) gives the firmware's protocol. The numbers are those of Digi's published
enumerations `HardwareVersion` and `XBeeProtocol` (digi-xbee 1.5.0); in this module all variants of
Zigbee are called Zigbee. Only 802.15.4 firmware broadcasts at the rate of wheel commands: Zigbee
allows about one broadcast per second, and DigiMesh repeats every broadcast.
"""

from typing import Literal

from pydantic import Field

from tetractl.spec.base import Model

REQUIRED_PROTOCOL = "802.15.4"
"""The protocol that the modules of the robots and of the computer must run."""
BAUD_RATES = (1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200)
"""Baud rates, in the order of the module's parameter BD, which is an index into them."""
ESCAPED_API_MODE = 2
"""Value of the module's parameter AP for API frames with escapes."""


class XbeeSection(Model):
    """The section of the spec for the XBee radio module at this computer."""

    port: str = Field(min_length=1, max_length=500)
    """The serial port, such as /dev/ttyUSB0."""
    baud: Literal[9600, 19200, 38400, 57600, 115200] = 57600
    """Bits per second on the port."""


SERIES_1_CODES = (0x17, 0x18)
"""Hardware codes (first byte of HV) of the modules of series 1."""
FAMILIES = (  # hardware codes of a family, and its protocol by the first digit of VR ("": others)
    (SERIES_1_CODES, {"": REQUIRED_PROTOCOL, "8": "DigiMesh"}),
    ((0x19, 0x1A, 0x1E, 0x32, 0x33, 0x34, 0x35), {"": "Zigbee"}),  # Series 2, S2D
    (
        (0x21, 0x22, 0x2D, 0x2E, 0x30),
        {"": "Zigbee", "2": REQUIRED_PROTOCOL, "9": "DigiMesh"},
    ),  # S2C
    ((0x53,), {"": "Zigbee", "C": REQUIRED_PROTOCOL, "B": "DigiMesh"}),  # S2C P5
    ((0x41, 0x42, 0x43), {"": "Zigbee", "2": REQUIRED_PROTOCOL, "3": "DigiMesh"}),  # XBee 3
    ((0x52, 0x57), {"": "Zigbee", "2": REQUIRED_PROTOCOL, "3": "DigiMesh"}),  # XBee RR
)


def find_protocols(hardware: bytes) -> dict[str, str]:
    """Return the protocols of a module's family, keyed by the first digit of VR.

    The key "" stands for all other digits. The result is empty if the HV value is unknown.
    """
    return next(
        (
            protocol_by_digit
            for codes, protocol_by_digit in FAMILIES
            if hardware and hardware[0] in codes
        ),
        {},
    )


def find_protocol(hardware: bytes, version: bytes) -> str | None:
    """Return the name of a module's protocol from its HV and VR values. None if it is unknown.

    If VR is empty, the protocol is known only for families with a single protocol.
    """
    candidates = find_protocols(hardware)
    if len(candidates) > 1 and not version:
        return None
    return candidates.get(version.hex().upper()[:1], candidates.get(""))
