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
from tetractl.lab.actuators.xbee.hardware import BAUD_RATES
from tetractl.lab.cobs import FrameSplitter
from tetractl.lab.serial_port import is_network
from tetractl_emulator.faults import ActingFaults
from tetractl_emulator.loop import Loop, Timeline

TERMINAL_FOLDER = Path("/dev/pts")
"""Folder of the system's pseudo-terminals."""
_BAUD_BY_SPEED_CODE = {vars(termios)[f"B{baud}"]: baud for baud in BAUD_RATES}
"""Baud rate of each speed code that `termios.tcgetattr` returns."""


def uart_ns(size: int, baud: int) -> int:
    """Compute the time [ns] that `size` bytes take on a serial line, at ten bits per byte.

    `baud` is the speed in bits/s. Parts of a nanosecond are dropped.
    """
    return size * 10 * SECOND // baud


class LineDirection:
    """One direction of a serial line. It computes when bytes have passed, one after the other.

    Args:
        timeline: The emulation's timeline.
        baud: Speed of the line [bits/s].
    """

    def __init__(self, timeline: Timeline, baud: int) -> None:
        self._timeline = timeline
        self._baud = baud
        self._idle_from_ns = 0  # when all bytes sent so far have passed

    def send(self, size: int) -> int:
        """Send `size` bytes over the line, after the bytes that are still on their way.

        Returns:
            The time at which the last byte has passed [ns].
        """
        start_ns = max(self._timeline.now_ns, self._idle_from_ns)
        self._idle_from_ns = start_ns + uart_ns(size, self._baud)
        return self._idle_from_ns


class SerialLine:
    """The serial line between a port and a device. The faults `baud` and `bad_bytes` act on it.

    Args:
        timeline: The emulation's timeline.
        baud: Speed in each direction [bits/s].
        acting: The faults that act now.

    Attributes:
        baud: Speed in each direction without a fault [bits/s].
        to_device: The direction from the port to the device.
        to_port: The direction from the device to the port.
    """

    def __init__(self, timeline: Timeline, baud: int, acting: ActingFaults) -> None:
        self.baud = baud
        self._acting = acting
        self.to_device = LineDirection(timeline, baud)
        self.to_port = LineDirection(timeline, baud)
        self._random = random.Random(baud)

    @property
    def device_baud(self) -> int:
        """The device's present baud rate [bits/s], which the fault `baud` changes."""
        wrong_baud = self._acting.newest("baud")
        return self.baud if wrong_baud is None else wrong_baud.baud

    def corrupt(self, data: bytes) -> bytes:
        """Return the bytes as the line delivers them. Their number does not change.

        During the fault `bad_bytes`, a random fraction of the bytes is replaced.
        """
        noise_fraction = self._acting.largest_share("bad_bytes")
        if not noise_fraction:
            return data
        random = self._random
        return bytes(
            random.randrange(256) if random.random() < noise_fraction else byte for byte in data
        )


class SerialDevice(ABC):
    """Base class of an emulated device on a serial port. Bytes take time on the serial line.

    Args:
        timeline: The timeline of the emulation.
        port: The port that programs open to talk to the device.
        baud: Speed of the device [bits/s].
        note: Called with each command when it is read from the port. None if no record is kept.
        acting: The faults that act now. None if no fault can act.

    Attributes:
        port: The port that programs open to talk to the device.
        note: Records an event, called as `note(event, **facts)`. Each command is recorded when it
            is read from the port. None if there is no record.
        acting: The faults that act now.
        line: The serial line between the port and the device.
        n_garbled_chunks: Number of chunks of bytes that a program sent at a wrong baud rate.
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
        self.n_garbled_chunks = 0
        self._timeline = timeline
        self._frame_splitter = FrameSplitter()  # each frame ends with a zero byte

    @abstractmethod
    def receive(self, data: bytes) -> None:
        """Process bytes that have arrived at the device over the serial line."""

    def _record_commands(self, data: bytes) -> None:
        """Record the commands in bytes from the port, even if they do not reach the device."""
        self._record_frames(self._frame_splitter.feed(data))

    def read_port(self) -> None:
        """Read the bytes that a program wrote to the port.

        The device receives them after the time that they need on the line.
        """
        while data := self.port.read():
            self._carry_to_device(data)

    def _carry_to_device(self, data: bytes) -> None:
        """Record bytes from the port, and deliver them to the device after the line's delay.

        The bytes are lost if the program has set a different speed from the device's, or if the
        device is restarting when they arrive.
        """
        if self.note is not None:
            self._record_commands(data)
        if self.port.baud() not in (self.line.device_baud, None):
            self.n_garbled_chunks += 1
            return
        delivered = self._as_delivered(data)
        arrival_ns = self.line.to_device.send(len(data))
        if delivered:
            self._timeline.at(arrival_ns, lambda: None if self.is_down else self.receive(delivered))

    def _as_delivered(self, data: bytes) -> bytes:
        """Return bytes as they are delivered: a fault may change them.

        If the port is a network address and the bytes were changed, the result is b"", because a
        damaged datagram is dropped.
        """
        delivered = self.line.corrupt(data)
        is_dropped = delivered != data and is_network(self.port.name)
        return b"" if is_dropped else delivered

    @property
    def is_down(self) -> bool:
        """Whether the device is restarting, and neither receives nor sends bytes."""
        return bool(self.acting.of_kind("radio_resets"))

    def _record_frames(self, frames: Sequence[bytes]) -> None:
        """Record each frame from the port as a command, or as garbage if it cannot be decoded."""
        assert self.note is not None, "only called if a record is kept"
        for frame in frames:
            try:
                self.note("command", **self._decode_command(frame))
            except WireError:
                self.note("garbage", hex=frame.hex())

    @abstractmethod
    def _decode_command(self, frame: bytes) -> dict[str, Any]:
        """Decode a command for the record.

        Args:
            frame: A frame that was read from the port.

        Returns:
            The facts of the command, by name.

        Raises:
            WireError: If the frame is not a command.
        """

    def _send_to_program(self, data: bytes) -> None:
        """Send bytes to the program. They arrive after the time that they need on the line.

        The bytes are lost if the device is restarting, or if a fault has changed its speed.
        """
        arrival_ns = self.line.to_port.send(len(data))
        if not self.is_down and self.line.device_baud == self.line.baud:
            delivered = self._as_delivered(data)
            if delivered:
                self._timeline.at(arrival_ns, lambda: self.port.write(delivered))


class PluggedDevices:
    """Base class of a group of devices whose ports are plugged in and unplugged together.

    Attributes:
        description: Name of the devices, for display, such as "robots".
    """

    description: ClassVar[str]
    _loop: Loop | None = None

    @property
    @abstractmethod
    def serial_devices(self) -> Sequence[SerialDevice]:
        """The devices of the group, each of which is on its own port."""

    def open(self, loop: Loop) -> dict[str, Any]:
        """Plug the devices in.

        Returns:
            Two entries: "actuator" maps to a text for display, which names the devices and their
            ports, and "port" maps to the name of the first port.
        """
        self._loop = loop
        self.set_plugged(True)
        port_names = [device.port.name for device in self.serial_devices]
        return {"actuator": f"{self.description} at {', '.join(port_names)}", "port": port_names[0]}

    def close(self) -> dict[str, Any]:
        """Unplug the devices.

        Returns:
            One entry: "garbled" maps to the number of chunks of bytes that programs sent at a wrong
            baud rate.
        """
        self.set_plugged(False)
        return {"garbled": sum(device.n_garbled_chunks for device in self.serial_devices)}

    def set_plugged(self, is_plugged: bool) -> None:
        """Plug the devices in, or unplug them.

        Args:
            is_plugged: True to plug them in, which is possible after `open`. False to unplug them,
                which can be repeated.
        """
        for device in self.serial_devices:
            if is_plugged:
                assert self._loop is not None, "open() sets the loop"
                device.port.plug()
                self._loop.watch(device.port.fd, device.read_port)
            else:
                if self._loop is not None:
                    self._loop.forget(device.port.fd)
                device.port.unplug()

    def set_stalled(self, is_stalled: bool) -> None:
        """Block all ports, or unblock them. A blocked port takes no bytes from the program.

        Args:
            is_stalled: True to block the ports, False to unblock them.
        """
        for device in self.serial_devices:
            device.port.set_stalled(is_stalled)


def _is_left_over(link: Path) -> bool:
    """Check whether a link was left behind by an emulation that was killed.

    The link's terminal then no longer exists, or a newer terminal has the same name.
    """
    if not link.is_symlink() or TERMINAL_FOLDER not in link.readlink().parents:
        return False
    try:
        return link.stat().st_ctime_ns > link.lstat().st_mtime_ns
    except FileNotFoundError:
        return True


class PseudoPort:
    """A pseudo-terminal that programs open like a serial port.

    A program can open the port exclusively, like any serial port. A second program is then refused.

    Args:
        link: Path to create for programs to open.

    Attributes:
        link: Path that is created for programs to open.
        name: The path as a string.
        fd: File descriptor of the emulated device's end. -1 while the port is unplugged.
    """

    def __init__(self, link: Path | str) -> None:
        self.link = Path(link)
        self.name = str(link)
        self.fd = -1
        # kept open, so that `fd` stays valid while no program has the port open
        self._program_fd = -1

    def plug(self) -> None:
        """Create the pseudo-terminal and a link to it. If this fails, both are removed again.

        Raises:
            UsageError: If the link cannot be created.
        """
        self.fd, self._program_fd = os.openpty()
        try:
            tty.setraw(self._program_fd)
            os.set_blocking(self.fd, False)
            self._create_link(os.ttyname(self._program_fd))
        except BaseException:
            self._close()
            raise

    def unplug(self) -> None:
        """Remove the port and its link. This method can be called repeatedly.

        A program that uses the port gets errors. If the link now leads elsewhere, it is kept.
        """
        if self.fd >= 0 and self.link.is_symlink() and str(self.link.readlink()) == self._terminal:
            self.link.unlink()
        self._close()

    def set_stalled(self, is_stalled: bool) -> None:
        """Block writes to the port, as if no device took the bytes, or allow them again."""
        if self.fd >= 0:
            termios.tcflow(self._program_fd, termios.TCOOFF if is_stalled else termios.TCOON)

    def baud(self) -> int | None:
        """Return the speed that the program has set on the port [bits/s].

        Returns:
            The speed. 0 if the port is closed or the speed is unknown. A subclass for a network
            returns None, because a network has no baud rate.
        """
        return (
            _BAUD_BY_SPEED_CODE.get(termios.tcgetattr(self._program_fd)[5], 0)
            if self.fd >= 0
            else 0
        )

    def read(self) -> bytes:
        """Return the bytes that the program has written to the port, at most 4096.

        The result is b"" if there are no bytes, or if the port is closed.
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
        """Send bytes to the program. Bytes that the program does not read are lost, as on a wire.

        The bytes are also lost if the port is not plugged in.
        """
        if self.fd >= 0:
            with suppress(BlockingIOError):
                os.write(self.fd, data)

    def _create_link(self, terminal: str) -> None:
        """Create the link to the terminal, and replace a link that a killed emulation has left.

        Raises:
            UsageError: If another file has this name, or if the link cannot be created.
        """
        if _is_left_over(self.link):
            self.link.unlink()
        try:
            self.link.symlink_to(terminal)
        except OSError as error:
            message = f"cannot create the link {self.link} to the emulated port: {error.strerror}"
            if error.errno == errno.EEXIST:
                message = (
                    f"cannot create the link {self.link}: a file of this name exists already, "
                    "perhaps a real device"
                )
            raise UsageError(
                message,
                hint=(
                    "choose another name with --port-link, and give the run the same name "
                    "with --set lab.actuator.port=NAME"
                ),
            ) from None
        self._terminal = terminal

    def _close(self) -> None:
        """Close both ends of the pseudo-terminal."""
        for open_fd in (self.fd, self._program_fd):
            if open_fd >= 0:
                os.close(open_fd)
        self.fd = self._program_fd = -1
