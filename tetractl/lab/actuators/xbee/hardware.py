"""XBee hardware and firmware versions, and the check of the PC's module before robots are driven.

The first byte of HV (hardware version) gives the hardware, and the first hexadecimal digit of VR
(firmware version) gives the firmware's protocol. The numbers are those of Digi's published
enumerations `HardwareVersion` and `XBeeProtocol` (digi-xbee 1.5.0); in this module all variants of
Zigbee are called Zigbee. Only 802.15.4 firmware broadcasts at the rate of wheel commands: Zigbee
allows about one broadcast per second, and DigiMesh repeats every broadcast.
"""

from typing import Literal, Protocol

from pydantic import Field

from tetractl.core.errors import AbortError
from tetractl.experiment.base import Model

RIGHT = "802.15.4"
BAUDS = (1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200)  # baud rate by the value of BD
ESCAPED_FRAMES = 2  # the value of AP for API frames with escapes
OTHER_BAUDS = (9600, 57600, 115200, 38400, 19200)


class XbeeSection(Model):
    """The XBee module at this computer."""

    port: str = Field(min_length=1, max_length=500)
    """The serial port, such as /dev/ttyUSB0."""
    baud: Literal[9600, 19200, 38400, 57600, 115200] = 57600
    """Bits per second on the port."""


SERIES_1 = (0x17, 0x18)
FAMILIES = (  # HV codes of a family, and its protocol by the first digit of VR; "": by all others
    (SERIES_1, {"": RIGHT, "8": "DigiMesh"}),
    ((0x19, 0x1A, 0x1E), {"": "Zigbee"}),  # Series 2
    ((0x21, 0x22, 0x2D, 0x2E, 0x30), {"": "Zigbee", "2": RIGHT, "9": "DigiMesh"}),  # S2C
    ((0x53,), {"": "Zigbee", "C": RIGHT, "B": "DigiMesh"}),  # S2C P5
    ((0x32, 0x33, 0x34, 0x35), {"": "Zigbee"}),  # S2D
    ((0x41, 0x42, 0x43), {"": "Zigbee", "2": RIGHT, "3": "DigiMesh"}),  # XBee 3
    ((0x52, 0x57), {"": "Zigbee", "2": RIGHT, "3": "DigiMesh"}),  # XBee RR
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
    found = protocols(hardware)
    if len(found) > 1 and not version:
        return None
    return found.get(version.hex().upper()[:1], found.get(""))


class AskedModule(Protocol):
    """The methods of a link that the check of a module needs."""

    def ask(self, command: bytes) -> bytes | None:
        """Request a parameter of the module; return its value, None if it gives none in time."""
        ...

    def set_baud(self, baud: int) -> None:
        """Change the baud rate of this side of the port."""
        ...


def check_module(link: AskedModule, radio: XbeeSection) -> tuple[str, ...]:
    """Raise AbortError unless an 802.15.4 module with AP=2 and the spec's baud rate answers.

    Returns questions for the operator: one if the module's protocol is not known, otherwise none.
    """
    # the first request may be lost behind an incomplete frame
    hardware = link.ask(b"HV") or link.ask(b"HV")
    if hardware is None:
        silent = _silent(link, radio)
        # a module that wakes late answers all requests at once, also those at another baud rate
        link.set_baud(radio.baud)
        hardware = link.ask(b"HV")
        if hardware is None:
            raise silent
    version = link.ask(b"VR") or b""
    runs = protocol(hardware, version)
    if runs not in (RIGHT, None):
        raise AbortError(
            f"{radio.port}: the module runs {runs} firmware, not {RIGHT}",
            "this firmware could not broadcast wheel commands fast enough; "
            + (
                f"load {RIGHT} firmware with XCTU"
                if RIGHT in protocols(hardware).values()
                else f"use a module that has {RIGHT} firmware: Series 1, S2C, XBee 3 or RR"
            ),
        )
    rate = _number(link.ask(b"BD"))
    if rate is not None and rate < len(BAUDS) and BAUDS[rate] != radio.baud:
        raise AbortError(
            f"{radio.port}: the module is set to {BAUDS[rate]} baud, not the spec's {radio.baud}",
            f"set lab.actuator.baud to {BAUDS[rate]}, or BD in the module",
        )
    if _number(link.ask(b"AP")) != ESCAPED_FRAMES:
        raise AbortError(
            f"{radio.port}: the module is not in API mode with escapes", "set its AP to 2 with XCTU"
        )
    if radio.baud == 115_200 and hardware and hardware[0] in SERIES_1:
        raise AbortError(
            f"{radio.port}: a Series 1 module loses API frames at 115200 baud",
            "set the module (BD=6) and lab.actuator.baud to 57600",
        )
    if runs is None:
        reported = version.hex().upper() or "not reported"
        module = f"the module (HV {hardware.hex().upper()}, VR {reported})"
        question = f"is not in tetractl's list: does it run {RIGHT} firmware?"
        return (f"{radio.port}: {module} {question}",)
    return ()


def _silent(link: AskedModule, radio: XbeeSection) -> AbortError:
    """Try the other baud rates; return the error for a module silent at the spec's baud rate."""
    for baud in OTHER_BAUDS:
        if baud == radio.baud:
            continue
        link.set_baud(baud)
        if link.ask(b"HV") is not None:
            return AbortError(
                f"{radio.port}: the module answers at {baud} baud, not the spec's {radio.baud}",
                f"set lab.actuator.baud to {baud}, or BD in the module",
            )
    return AbortError(
        f"{radio.port}: no XBee module answers at {radio.baud} or any other baud rate",
        "is the module in API mode (AP=2)? is it an XBee, and does it have power?",
    )


def _number(value: bytes | None) -> int | None:
    return None if value is None else int.from_bytes(value, "big")
