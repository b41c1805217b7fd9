"""What the PC's module must be before robots are driven through it.

Firmware by HV (hardware version) and VR (firmware version): only 802.15.4 firmware broadcasts at
the rate of wheel commands; Zigbee allows about one broadcast a second and DigiMesh repeats each.
"""

from typing import Protocol

from tetractl.core.errors import AbortError
from tetractl.lab.actuators.xbee.section import XbeeSection

BAUDS = (1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200)  # by the value of BD
MODES = {0: "transparent", 1: "api1", 2: "api2"}  # by the value of AP
SERIES_1 = (0x17, 0x18)
OTHER_BAUDS = (9600, 57600, 115200, 38400, 19200)

# family by the first byte of HV, then protocol by the first byte of VR
FAMILIES: dict[tuple[int, ...], tuple[str, dict[int, str]]] = {
    SERIES_1: ("Series 1", {0x10: "802.15.4", 0x80: "DigiMesh", 0x81: "DigiMesh"}),
    (0x19, 0x1A, 0x1E): ("Series 2", {}),
    (0x21, 0x22, 0x23, 0x2D, 0x2E): ("S2C", {0x20: "802.15.4", 0x40: "Zigbee", 0x90: "DigiMesh"}),
    (0x41, 0x42, 0x43): ("XBee 3", {0x20: "802.15.4", 0x10: "Zigbee", 0x30: "DigiMesh"}),
}


class AskedModule(Protocol):
    """What is asked of a link."""

    def ask(self, command: bytes, timeout_s: float = ...) -> bytes | None:
        """Ask for a parameter; None without an answer."""
        ...

    def set_baud(self, baud: int) -> None:
        """Speak at another rate."""
        ...


def module(link: AskedModule, radio: XbeeSection) -> None:
    """Raise AbortError unless an 802.15.4 module in the spec's mode and rate answers."""
    hardware = link.ask(b"HV") or link.ask(b"HV")  # the first may meet the end of a broken frame
    if hardware is None:
        raise _silent(link, radio)
    protocol = firmware(hardware, link.ask(b"VR") or b"")
    if protocol != "802.15.4":
        raise AbortError(
            f"{radio.port}: the module runs {protocol} firmware, not 802.15.4",
            "it could not broadcast wheel commands fast enough; load 802.15.4 firmware with XCTU",
        )
    rate = _number(link.ask(b"BD"))
    if rate is not None and rate < len(BAUDS) and BAUDS[rate] != radio.baud:
        raise AbortError(
            f"{radio.port}: the module says {BAUDS[rate]} baud, the spec {radio.baud}",
            f"set lab.actuator.baud to {BAUDS[rate]}, or BD in the module",
        )
    mode = MODES.get(_number(link.ask(b"AP")) or 0, "an unknown mode")
    if mode != radio.mode:
        raise AbortError(
            f"{radio.port}: the module is in {mode}, the spec says {radio.mode}",
            f"set lab.actuator.mode to {mode}, or AP in the module",
        )
    if radio.baud == 115_200 and hardware[0] in SERIES_1:
        raise AbortError(
            f"{radio.port}: a Series 1 module loses API frames at 115200 baud",
            "use 57600 (BD=6) and set lab.actuator.baud to it",
        )


def firmware(hardware: bytes, version: bytes) -> str:
    """Return the protocol that HV and VR tell, in words for people."""
    for codes, (family, protocols) in FAMILIES.items():
        if hardware and hardware[0] in codes:
            if family == "Series 2":
                return "Zigbee"
            known = protocols.get(version[0] if version else -1)
            return known or f"unknown {family} (VR {version.hex().upper() or 'not told'})"
    return f"unknown (HV {hardware.hex().upper()}, VR {version.hex().upper()})"


def _silent(link: AskedModule, radio: XbeeSection) -> AbortError:
    """Find out why nothing answers: try the other rates."""
    for baud in OTHER_BAUDS:
        if baud == radio.baud:
            continue
        link.set_baud(baud)
        if link.ask(b"HV") is not None:
            return AbortError(
                f"{radio.port}: the module speaks {baud} baud, the spec says {radio.baud}",
                f"set lab.actuator.baud to {baud}, or BD in the module",
            )
    return AbortError(
        f"{radio.port}: no XBee module answers at {radio.baud} baud or another",
        "is it in an API mode (AP=1 or 2)? is it an XBee, and has it power?",
    )


def _number(value: bytes | None) -> int | None:
    return None if value is None else int.from_bytes(value, "big")
