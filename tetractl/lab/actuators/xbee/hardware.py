"""XBee hardware and firmware versions, and the section of the module in a spec.

The first byte of HV (hardware version) gives the hardware, and the first hexadecimal digit of VR
(firmware version) gives the firmware's protocol. The numbers are those of Digi's published
enumerations `HardwareVersion` and `XBeeProtocol` (digi-xbee 1.5.0); in this module all variants of
Zigbee are called Zigbee. Only 802.15.4 firmware broadcasts at the rate of wheel commands: Zigbee
allows about one broadcast per second, and DigiMesh repeats every broadcast.
"""

from typing import Literal

from pydantic import Field

from tetractl.experiment.base import Model

RIGHT_PROTOCOL = "802.15.4"  # the protocol that modules of robots and computer run
BAUDS = (1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200)  # baud rate by the value of BD
ESCAPED_FRAMES = 2  # the value of AP for API frames with escapes


class XbeeSection(Model):
    """The XBee module at this computer."""

    port: str = Field(min_length=1, max_length=500)
    """The serial port, such as /dev/ttyUSB0."""
    baud: Literal[9600, 19200, 38400, 57600, 115200] = 57600
    """Bits per second on the port."""


SERIES_1 = (0x17, 0x18)  # first bytes of HV of modules of series 1
FAMILIES = (  # HV codes of a family, and its protocol by the first digit of VR; "": by all others
    (SERIES_1, {"": RIGHT_PROTOCOL, "8": "DigiMesh"}),
    ((0x19, 0x1A, 0x1E), {"": "Zigbee"}),  # Series 2
    ((0x21, 0x22, 0x2D, 0x2E, 0x30), {"": "Zigbee", "2": RIGHT_PROTOCOL, "9": "DigiMesh"}),  # S2C
    ((0x53,), {"": "Zigbee", "C": RIGHT_PROTOCOL, "B": "DigiMesh"}),  # S2C P5
    ((0x32, 0x33, 0x34, 0x35), {"": "Zigbee"}),  # S2D
    ((0x41, 0x42, 0x43), {"": "Zigbee", "2": RIGHT_PROTOCOL, "3": "DigiMesh"}),  # XBee 3
    ((0x52, 0x57), {"": "Zigbee", "2": RIGHT_PROTOCOL, "3": "DigiMesh"}),  # XBee RR
    ((0x5C, 0x5D), {"": "Bluetooth"}),  # XBee 3 BLU
    ((0x1F, 0x27, 0x28), {"": "Wi-Fi"}),
    (
        (0x2A, 0x40, 0x44, *range(0x46, 0x4C), 0x4D, 0x4E, 0x54, 0x55, 0x56, 0x58, 0x59),
        {"": "cellular"},
    ),
    ((0x1B, 0x1C, 0x23, 0x26, 0x2C, 0x50, 0x5A), {"": "900 MHz"}),
    ((0x1D, 0x24, 0x45, 0x51, 0x5B), {"": "868 MHz"}),
    ((0x29,), {"": "475 MHz"}),
    ((0x13, 0x14, 0x2B, 0x2F, 0x31, 0x3E, 0x3F), {"": "long-range"}),  # XTend, SX and XLR
    ((0x20,), {"": "M-Bus"}),
    ((*range(0x01, 0x13), 0x15, 0x16), {"": "XStream"}),
)


def protocols(hardware: bytes) -> dict[str, str]:
    """Return the protocols of a module's family by the first digit of VR, with the key "" for all
    other digits; nothing if its HV value is unknown.
    """
    return next((named for codes, named in FAMILIES if hardware and hardware[0] in codes), {})


def protocol(hardware: bytes, version: bytes) -> str | None:
    """Return the name of a module's protocol by its HV and VR values, None if unknown.

    If VR is empty, the protocol is known only for families with a single protocol.
    """
    candidates = protocols(hardware)
    if len(candidates) > 1 and not version:
        return None
    return candidates.get(version.hex().upper()[:1], candidates.get(""))
