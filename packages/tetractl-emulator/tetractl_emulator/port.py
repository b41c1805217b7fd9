"""Serial ports of emulated devices, and base classes of the devices on them.

A `PseudoPort` is a pseudo-terminal that programs open by a chosen name, such as /tmp/radio. A
`SerialDevice` receives the bytes that programs write after the time that they need on the line, ten
bits per byte, and its answers take as long. At a wrong baud rate, it receives nothing. On a
network, each datagram is received whole or lost. `PluggedDevices` are plugged in and unplugged
together.
"""

import errno
import os
import random
import termios
import tty
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar

from tetractl.core.clock import SECOND
from tetractl.core.errors import UsageError, WireError
from tetractl.lab.actuators.xbee.hardware import BAUDS
from tetractl.lab.cobs import Splitter
from tetractl.lab.serial_port import is_network
from tetractl_emulator.faults import ActingFaults
from tetractl_emulator.loop import Loop, Timeline

TERMINALS = Path("/dev/pts")
_BAUDS = {vars(termios)[f"B{baud}"]: baud for baud in BAUDS}


def uart_ns(size: int, baud: int) -> int:
    """Compute the time [ns] that `size` bytes take on a serial line, at ten bits per byte.

    `baud` is the speed in bits/s. Parts of a nanosecond are dropped.
    """
    return size * 10 * SECOND // baud


class OneWay:
    """One direction of a serial line, on which bytes pass one after the other.

    Args:
        timeline: The emulation's timeline.
        baud: Speed of the line [bits/s].
    """

    def __init__(self, timeline: Timeline, baud: int) -> None:
        self._timeline = timeline
        self._baud = baud
        self._free_ns = 0  # when the bytes on their way have passed

    def send(self, size: int) -> int:
        """Send `size` bytes, after those that are still on the line.

        Returns:
            The time at which the last byte has passed [ns].
        """
        start_ns = max(self._timeline.now_ns, self._free_ns)
        self._free_ns = start_ns + uart_ns(size, self._baud)
        return self._free_ns


class SerialLine:
    """The line between a port and a device. The faults `baud` and `bad_bytes` act on it.

    Args:
        timeline: The emulation's timeline.
        baud: Speed in each direction [bits/s].
        acting: The faults that act now.
    """

    def __init__(self, timeline: Timeline, baud: int, acting: ActingFaults) -> None:
        self.baud = baud
        self._acting = acting
        self.to_device = OneWay(timeline, baud)
        self.to_port = OneWay(timeline, baud)
        self._chance = random.Random(baud)

    @property
    def speed(self) -> int:
        """The baud rate of the device, which the fault `baud` replaces by another one."""
        wrong_baud = self._acting.newest("baud")
        return self.baud if wrong_baud is None else wrong_baud.baud

    def disturbed(self, data: bytes) -> bytes:
        """Return the bytes as the line delivers them, as many as were sent.

        During the fault `bad_bytes`, a random fraction of them is replaced.
        """
        noise = self._acting.largest_share("bad_bytes")
        if not noise:
            return data
        chance = self._chance
        return bytes(chance.randrange(256) if chance.random() < noise else byte for byte in data)


class SerialDevice(ABC):
    """Base class of a device that receives bytes from a port and answers, with a line's delays.

    Args:
        timeline: The timeline of the emulation.
        port: The port.
        baud: Speed of the device [bits per second].
        note: Called with each command when it is read from the port. None if no record is kept.
        acting: The faults that act now. None for none.

    Attributes:
        port: The port.
        note: Records an event, called as `note(event, **facts)`. Each command is recorded when it
            is read from the port. None if there is no record.
        acting: The faults that act now.
        line: The line between the port and the device.
        garbled: Number of chunks that were sent at another baud rate than the device's.
    """

    def __init__(
        self,
        timeline: Timeline,
        port: "PseudoPort",
        baud: int,
        note: Callable[..., None] | None,
        acting: ActingFaults | None = None,
    ) -> None:
        self.port = port
        self.note = note
        self.acting = acting or ActingFaults()
        self.line = SerialLine(timeline, baud, self.acting)
        self.garbled = 0
        self._timeline = timeline
        self._splitter = Splitter()  # of frames closed by 00

    @abstractmethod
    def hear(self, data: bytes) -> None:
        """Process bytes that have arrived at the device over the serial line."""

    def _witness(self, data: bytes) -> None:
        """Record the commands in bytes read from the port, even if they do not reach the device."""
        self._note_commands(self._splitter.feed(data))

    def readable(self) -> None:
        """Read the bytes that a program wrote to the port.

        The device receives them after the time that they need on the line.
        """
        while data := self.port.read():
            self._came(data)

    def _came(self, data: bytes) -> None:
        """Record bytes from the port, and deliver them to the device unless they are lost.

        They are lost if the program has set another speed than the device's, or if the device is
        restarting when they arrive.
        """
        if self.note is not None:
            self._witness(data)
        if self.port.baud() not in (self.line.speed, None):
            self.garbled += 1
            return
        passed = self._passed(data)
        heard_ns = self.line.to_device.send(len(data))
        if passed:
            self._timeline.at(heard_ns, lambda: None if self.is_down else self.hear(passed))

    def _passed(self, data: bytes) -> bytes:
        """Return bytes as they are delivered, which a fault may have changed.

        For a network, the result is b"" if they were changed, because a damaged datagram is
        dropped.
        """
        passed = self.line.disturbed(data)
        is_dropped = passed != data and is_network(self.port.name)
        return b"" if is_dropped else passed

    @property
    def is_down(self) -> bool:
        """Whether the device is restarting, and neither receives nor sends bytes."""
        return bool(self.acting.of_kind("radio_resets"))

    def _note_commands(self, frames: Sequence[bytes]) -> None:
        """Record each frame from the port as a command, or as garbage if it cannot be decoded."""
        assert self.note is not None, "nothing is witnessed without a record"
        for sealed in frames:
            try:
                self.note("command", **self._command(sealed))
            except WireError:
                self.note("garbage", hex=sealed.hex())

    @abstractmethod
    def _command(self, sealed: bytes) -> dict[str, Any]:
        """Decode a command for the record.

        Args:
            sealed: A frame that was read from the port.

        Returns:
            The facts of the command, by name.

        Raises:
            WireError: If the frame is not a command.
        """

    def _answer(self, data: bytes) -> None:
        """Send bytes to the program, after the time that they need on the line.

        They are lost if the device is restarting, or if a fault has changed its speed.
        """
        come_ns = self.line.to_port.send(len(data))
        if not self.is_down and self.line.speed == self.line.baud:
            passed = self._passed(data)
            if passed:
                self._timeline.at(come_ns, lambda: self.port.write(passed))


class PluggedDevices:
    """Base class of devices on ports that are plugged in and unplugged together.

    Attributes:
        what: Description of the devices, for display.
    """

    what: ClassVar[str]
    _loop: Loop | None = None

    @property
    @abstractmethod
    def wired(self) -> Sequence[SerialDevice]:
        """The devices that receive bytes and answer, each on one port."""

    def open(self, loop: Loop) -> dict[str, Any]:
        """Plug the devices in.

        Returns:
            Two entries: "actuator" maps to a description for display, and "port" to the name of the
            first port.
        """
        self._loop = loop
        self.plugged(True)
        ports = [device.port.name for device in self.wired]
        return {"actuator": f"{self.what} at {', '.join(ports)}", "port": ports[0]}

    def close(self) -> dict[str, Any]:
        """Unplug the devices.

        Returns:
            One entry: "garbled" maps to the number of chunks that were received at a wrong baud
            rate.
        """
        self.plugged(False)
        return {"garbled": sum(device.garbled for device in self.wired)}

    def plugged(self, on: bool) -> None:
        """Plug the devices in, or unplug them.

        Args:
            on: Whether to plug them in, which is possible after `open`. Unplugging can be repeated.
        """
        for device in self.wired:
            if on:
                assert self._loop is not None, "open() sets the loop"
                device.port.plug()
                self._loop.watch(device.port.fd, device.readable)
            else:
                if self._loop is not None:
                    self._loop.forget(device.port.fd)
                device.port.unplug()

    def stall(self, stalled: bool) -> None:
        """Stop all ports from taking bytes if `stalled`, or let them take bytes again.

        The bytes concerned are those that the program writes.
        """
        for device in self.wired:
            device.port.stall(stalled)


def _left_over(link: Path) -> bool:
    """Check whether a link was left behind by an emulation that was killed.

    Its terminal is then gone, or is another one that was created later with the same number.
    """
    if not link.is_symlink() or TERMINALS not in link.readlink().parents:
        return False
    try:
        return link.stat().st_ctime_ns > link.lstat().st_mtime_ns
    except FileNotFoundError:
        return True


class PseudoPort:
    """A pseudo-terminal that programs open like a serial port.

    As with any serial port, a program can open it exclusively. A second program is then refused.

    Attributes:
        link: Path that is created for programs to open.
        name: The path as text.
        fd: File descriptor of the emulated device's end. -1 while the port is unplugged.
    """

    def __init__(self, link: Path | str) -> None:
        self.link = Path(link)
        self.name = str(link)
        self.fd = -1
        # kept open, so that `fd` stays valid while no program has the port open
        self._far = -1

    def plug(self) -> None:
        """Create the pseudo-terminal and the link to it. If this fails, nothing is left behind.

        Raises:
            UsageError: If the link cannot be created.
        """
        self.fd, self._far = os.openpty()
        try:
            tty.setraw(self._far)
            os.set_blocking(self.fd, False)
            self._make_link(os.ttyname(self._far))
        except BaseException:
            self._close()
            raise

    def unplug(self) -> None:
        """Remove the port and its link. This method can be called repeatedly.

        A program that uses the port gets errors. A link that leads elsewhere by now is kept.
        """
        if self.fd >= 0 and self.link.is_symlink() and str(self.link.readlink()) == self._target:
            self.link.unlink()
        self._close()

    def stall(self, stalled: bool) -> None:
        """Block writes to the port, as if no device took the bytes, or allow them again."""
        if self.fd >= 0:
            termios.tcflow(self._far, termios.TCOOFF if stalled else termios.TCOON)

    def baud(self) -> int | None:
        """Return the speed that the program has set [bits/s].

        It is 0 if the port is closed or the speed is unknown. A subclass for a network returns
        None.
        """
        return _BAUDS.get(termios.tcgetattr(self._far)[5], 0) if self.fd >= 0 else 0

    def read(self) -> bytes:
        """Return the bytes that the program has written to the port, at most 4096.

        b"" if there are none, or if the port is closed.
        """
        try:
            return os.read(self.fd, 4096) if self.fd >= 0 else b""
        except BlockingIOError:
            return b""
        except OSError as error:
            if error.errno == errno.EIO:
                return b""
            raise

    def write(self, data: bytes) -> None:
        """Send bytes to the program. Bytes that it does not read are lost, as on a wire.

        They are also lost if the port is not plugged in.
        """
        if self.fd >= 0:
            with suppress(BlockingIOError):
                os.write(self.fd, data)

    def _make_link(self, target: str) -> None:
        """Create the link to the terminal, and replace a link that a killed emulation has left.

        Raises:
            UsageError: If another file has this name, or if the link cannot be created.
        """
        if _left_over(self.link):
            self.link.unlink()
        try:
            self.link.symlink_to(target)
        except OSError as error:
            why = f"cannot create the link {self.link} to the emulated port: {error.strerror}"
            if error.errno == errno.EEXIST:
                why = (
                    f"cannot create the link {self.link}: a file of this name exists already, "
                    "perhaps a real device"
                )
            raise UsageError(
                why,
                hint=(
                    "choose another name with --port-link, and give the run the same name "
                    "with --set lab.actuator.port=NAME"
                ),
            ) from None
        self._target = target

    def _close(self) -> None:
        """Close both ends of the pseudo-terminal."""
        for fd in (self.fd, self._far):
            if fd >= 0:
                os.close(fd)
        self.fd = self._far = -1
