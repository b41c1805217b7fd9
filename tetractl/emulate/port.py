"""An emulated device's serial port: a pseudo-terminal under a name of its own."""

import errno
import os
import termios
import tty
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from tetractl.core.errors import UsageError
from tetractl.emulate.loop import Loop

_BAUDS = {
    getattr(termios, f"B{baud}"): baud for baud in (1200, 2400, 4800, 9600, 19200, 38400, 57600)
} | {termios.B115200: 115200}


class PluggedDevice:
    """A device on a port that can be pulled out; `readable` is called when bytes have come."""

    port: "PseudoPort"
    readable: Callable[[], None]
    _loop: Loop | None = None

    def plug(self) -> None:
        """Plug the device in."""
        assert self._loop is not None, "open() gives the loop"
        self.port.plug()
        self._loop.watch(self.port.fd, self.readable)

    def plugged(self, on: bool) -> None:
        """Plug the device in, or pull it out."""
        if on:
            self.plug()
        else:
            self.unplug()

    def unplug(self) -> None:
        """Pull the device out; idempotent."""
        if self._loop is not None:
            self._loop.forget(self.port.fd)
        self.port.unplug()


class PseudoPort:
    """A serial port that others open by the name `link`; `fd` is our end of it.

    Opening it exclusively works as with any port: the second opener is refused.
    """

    def __init__(self, link: Path) -> None:
        self.link = link
        self.fd = -1
        self._far = -1  # kept open, so that our end lives on while the port is not open

    def plug(self) -> None:
        """Make the port and its name; UsageError if the name cannot be had."""
        self.fd, self._far = os.openpty()
        try:
            tty.setraw(self._far)
            os.set_blocking(self.fd, False)
            self._make_link(os.ttyname(self._far))
        except BaseException:
            self._close()
            raise

    def unplug(self) -> None:
        """Take port and name away; its user gets errors. Idempotent."""
        self._remove_link()
        self._close()

    def stall(self, stalled: bool) -> None:
        """Let writes to the port wait, as if nothing took its bytes; or go on."""
        if self.fd >= 0:
            termios.tcflow(self._far, termios.TCOOFF if stalled else termios.TCOON)

    def baud(self) -> int:
        """Return the bits per second that the other side has set; 0 for a speed not known here."""
        return _BAUDS.get(termios.tcgetattr(self._far)[5], 0) if self.fd >= 0 else 0

    def read(self) -> bytes:
        """Return what was written to the port."""
        try:
            return os.read(self.fd, 4096) if self.fd >= 0 else b""
        except BlockingIOError:
            return b""
        except OSError as error:
            if error.errno == errno.EIO:
                return b""
            raise

    def write(self, data: bytes) -> None:
        """Hand bytes to the other side; what it does not take is lost, as on a wire."""
        if self.fd >= 0:
            with suppress(BlockingIOError):
                os.write(self.fd, data)

    def _make_link(self, target: str) -> None:
        if self.link.is_symlink() and not self.link.exists():
            self.link.unlink()  # left by an emulation that was killed
        try:
            self.link.symlink_to(target)
        except FileExistsError:
            raise UsageError(
                f"{self.link} is there already, perhaps a real device",
                hint="choose another name with --port-link, and give it to the runner by "
                "--set lab.actuator.port=NAME",
            ) from None
        except OSError as error:
            raise UsageError(
                f"cannot make the port {self.link}: {error.strerror}",
                hint="choose another name with --port-link, and give it to the runner by "
                "--set lab.actuator.port=NAME",
            ) from None
        self._target = target

    def _remove_link(self) -> None:
        if self.fd >= 0 and self.link.is_symlink() and str(self.link.readlink()) == self._target:
            self.link.unlink()

    def _close(self) -> None:
        for fd in (self.fd, self._far):
            if fd >= 0:
                os.close(fd)
        self.fd = self._far = -1
