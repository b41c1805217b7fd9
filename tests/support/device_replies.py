"""The replies of both firmwares, packed as a device sends them."""

from dataclasses import astuple

from tetractl_microscope.coils import driver

from tetractl.lab import cobs
from tetractl.lab.actuators.m3pi import broadcast


def packed_reply(reply):
    """Return a reply's frame, including the closing byte 00."""
    module = broadcast if isinstance(reply, broadcast.Reply) else driver
    return cobs.pack_fields(module._REPLY, module.REPLY, *astuple(reply))
