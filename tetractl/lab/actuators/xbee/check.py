"""What the PC's module must be before robots are driven through it.

Only 802.15.4 firmware broadcasts at the rate of wheel commands; Zigbee allows about one broadcast a
second and DigiMesh repeats each.
"""

from typing import Protocol

from tetractl.core.errors import AbortError
from tetractl.lab.actuators.xbee.hardware import RIGHT, SERIES_1, capable, family, protocol
from tetractl.lab.actuators.xbee.section import XbeeSection

BAUDS = (1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200)  # by the value of BD
MODES = {0: "transparent", 1: "api1", 2: "api2"}  # by the value of AP
OTHER_BAUDS = (9600, 57600, 115200, 38400, 19200)


class AskedModule(Protocol):
    """What is asked of a link."""

    def ask(self, command: bytes, timeout_s: float = ...) -> bytes | None:
        """Ask for a parameter; None without an answer."""
        ...

    def set_baud(self, baud: int) -> None:
        """Speak at another rate."""
        ...


def module(link: AskedModule, radio: XbeeSection) -> tuple[str, ...]:
    """Raise AbortError unless an 802.15.4 module in the spec's mode and rate answers.

    Return what a person has to say of it: of hardware that is not known here, whether its firmware
    is the right one.
    """
    hardware = link.ask(b"HV") or link.ask(b"HV")  # the first may meet the end of a broken frame
    if hardware is None:
        raise _silent(link, radio)
    version = link.ask(b"VR") or b""
    runs = protocol(hardware, version)
    if runs not in (RIGHT, None):
        raise AbortError(
            f"{radio.port}: the module runs {runs} firmware, not {RIGHT}",
            "it could not broadcast wheel commands fast enough; "
            + (
                f"load {RIGHT} firmware with XCTU"
                if capable(family(hardware))
                else f"take a module that has {RIGHT} firmware: Series 1, S2C, XBee 3 or RR"
            ),
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
    if radio.baud == 115_200 and family(hardware) is SERIES_1:
        raise AbortError(
            f"{radio.port}: a Series 1 module loses API frames at 115200 baud",
            "use 57600 (BD=6) and set lab.actuator.baud to it",
        )
    if runs is None:
        told = version.hex().upper() or "not told"
        question = f"the module (HV {hardware.hex().upper()}, VR {told}) is not known here"
        return (f"{radio.port}: {question}: does it run {RIGHT} firmware?",)
    return ()


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
