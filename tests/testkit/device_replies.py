"""Packs the replies of a device's firmware in the same way as the device."""

import inspect
from dataclasses import astuple

from tetractl.lab import cobs
from tetractl.lab.actuators.m3pi import broadcast
from tetractl.lab.actuators.wheel_commands import Reply


def packed_reply(reply):
    """Return a reply's frame, including the closing byte 00."""
    module = broadcast if isinstance(reply, Reply) else inspect.getmodule(type(reply))
    return cobs.pack_fields(module._REPLY, module.REPLY, *astuple(reply))


def reply_line(reply):
    """Return the line of a reply, with its end."""
    numbers = [str(int(number)) for number in astuple(reply)]
    text = " ".join(["S", *numbers]).encode()
    return text + b"*%04X\n" % cobs.crc16(text)
