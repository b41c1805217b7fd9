"""The fields of the spec for an XBee module on a serial port."""

from typing import Literal

from pydantic import Field

from tetractl.experiment.base import Model


class XbeeSection(Model):
    """The XBee module at this computer."""

    port: str = Field(min_length=1, max_length=500)
    """The serial port, such as /dev/ttyUSB0."""
    baud: Literal[9600, 19200, 38400, 57600, 115200] = 57600
    """Bits a second on the port."""
    mode: Literal["api2", "api1", "transparent"] = "api2"
    """`api2`: escaped API frames (AP=2); `api1`: plain API frames (AP=1); `transparent`: bytes as
    they are."""
