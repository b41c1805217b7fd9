"""What an XBee module is and runs, by HV (hardware version) and VR (firmware version).

The first byte of HV tells the hardware, the first hexadecimal digit of VR the protocol of its
firmware. The numbers are those of Digi's published enumerations `HardwareVersion` and
`XBeeProtocol` (digi-xbee 1.5.0); of Zigbee's relatives all are called Zigbee here.
"""

from dataclasses import dataclass, field

RIGHT = "802.15.4"


@dataclass(frozen=True, slots=True)
class Hardware:
    """A family of modules: its HV codes, and its protocols by the first digit of VR.

    `otherwise` is what every other firmware is.
    """

    name: str
    codes: tuple[int, ...]
    otherwise: str
    protocols: dict[str, str] = field(default_factory=dict)


SERIES_1 = Hardware("Series 1", (0x17, 0x18), RIGHT, {"8": "DigiMesh"})
FAMILIES = (
    SERIES_1,
    Hardware("Series 2", (0x19, 0x1A, 0x1E), "Zigbee"),
    Hardware("S2C", (0x21, 0x22, 0x2D, 0x2E, 0x30), "Zigbee", {"2": RIGHT, "9": "DigiMesh"}),
    Hardware("S2C P5", (0x53,), "Zigbee", {"C": RIGHT, "B": "DigiMesh"}),
    Hardware("S2D", (0x32, 0x33, 0x34, 0x35), "Zigbee"),
    Hardware("XBee 3", (0x41, 0x42, 0x43), "Zigbee", {"2": RIGHT, "3": "DigiMesh"}),
    Hardware("XBee RR", (0x52, 0x57), "Zigbee", {"2": RIGHT, "3": "DigiMesh"}),
    Hardware("XBee 3 BLU", (0x5C, 0x5D), "Bluetooth"),
    Hardware("Wi-Fi", (0x1F, 0x27, 0x28), "Wi-Fi"),
    Hardware(
        "cellular",
        (0x2A, 0x40, 0x44, *range(0x46, 0x4C), 0x4D, 0x4E, 0x54, 0x55, 0x56, 0x58, 0x59),
        "cellular",
    ),
    Hardware("900 MHz", (0x1B, 0x1C, 0x23, 0x26, 0x2C, 0x50, 0x5A), "900 MHz"),
    Hardware("868 MHz", (0x1D, 0x24, 0x45, 0x51, 0x5B), "868 MHz"),
    Hardware("475 MHz", (0x29,), "475 MHz"),
    Hardware("XTend, SX and XLR", (0x13, 0x14, 0x2B, 0x2F, 0x31, 0x3E, 0x3F), "long-range"),
    Hardware("M-Bus", (0x20,), "M-Bus"),
    Hardware("XStream", (*range(0x01, 0x13), 0x15, 0x16), "XStream"),
)


def family(hardware: bytes) -> Hardware | None:
    """Return the family of a module by its HV, None where it is not known."""
    return next((f for f in FAMILIES if hardware and hardware[0] in f.codes), None)


def capable(found: Hardware | None) -> bool:
    """Return whether 802.15.4 firmware exists for a family."""
    return found is not None and RIGHT in (found.otherwise, *found.protocols.values())


def protocol(hardware: bytes, version: bytes) -> str | None:
    """Return what a module runs by HV and VR, in words for people; None where that is not known.

    Without VR it is known only of families that run one protocol alone.
    """
    found = family(hardware)
    if found is None or (found.protocols and not version):
        return None
    return found.protocols.get(version.hex().upper()[:1], found.otherwise)
