"""Base class for devices that are used like a serial port, but reached in another way.

Such a device is reached through a manufacturer's library or through another process.
"""

from abc import ABC, abstractmethod
from contextlib import suppress

from tetractl.core.errors import AbortError
from tetractl.lab.serial_port import SerialPort


class ClientPort(SerialPort, ABC):
    """A port that receives messages from a manufacturer's library or from another process.

    The port runs a thread. This thread calls `connect`, then `wait` again and again until the port
    is closed, and finally `disconnect`. A subclass passes each message to `take`, either from this
    thread or from threads of the library. If `connect` or `wait` raises an exception, or the
    subclass calls `lost`, the port has failed, and the trial ends.
    """

    @abstractmethod
    def connect(self) -> None:
        """Connect to the device. If this fails, raise an exception that explains why."""

    def wait(self) -> None:
        """Wait for the next message, and pass it to `take`. Return after about 0.1 s at most.

        If the library calls back with each message, a subclass need not define this method.
        """
        self._closing.wait(0.1)

    def disconnect(self) -> None:
        """Disconnect from the device, and release the library.

        This is called once, even if `connect` has failed. Exceptions are ignored.
        """

    @property
    def name(self) -> str:
        """The name of the port in the spec."""
        return self._name

    def take(self, message: bytes, waited_ns: int = 0) -> None:
        """Pass a received message on to the owner of the port.

        Args:
            message: The message.
            waited_ns: How long ago the message arrived [ns].
        """
        self._on_received(message, self._clock.now() - waited_ns)

    def lost(self, reason: object) -> None:
        """Report that the connection to the device has failed, so that no more messages will come.

        Args:
            reason: Why the connection has failed. It is converted to a string.
        """
        self._report_failure(f"{self._device}: {reason}")

    def open(self, exclusive: bool = True) -> None:
        """Start the thread that connects and receives messages. `exclusive` has no effect."""
        self._thread.start()

    def write(self, data: bytes) -> int:
        """Ignore the data, because this port only receives, and return the present time [ns].

        Raises:
            AbortError: If the port has failed.
        """
        if self.failure:
            raise AbortError(self.failure, self._hint)
        return self._clock.now()

    def _read(self) -> None:
        """Connect and pass messages on until the port is closed. This runs in its own thread."""
        try:
            self.connect()
            while not (self._closing.is_set() or self.failure):
                self.wait()
        except AbortError as error:
            self._report_failure(error.message)
        except Exception as error:  # a library may raise anything
            self.lost(str(error) or type(error).__name__)
        with suppress(Exception):
            self.disconnect()
