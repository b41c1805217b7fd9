"""Base class for devices that are used like a serial port, but reached in another way.

Such a device is reached through a manufacturer's library, or through another process.
"""

from abc import ABC, abstractmethod
from contextlib import suppress

from tetractl.core.errors import AbortError
from tetractl.lab.serial_port import SerialPort


class ClientPort(SerialPort, ABC):
    """A port that receives messages from a manufacturer's library or from another process.

    The spec calls it `name`. A thread calls `connect`, then `wait` again and again until the port
    is closed, then `disconnect`. If one of these methods raises an exception, or calls `lost`, the
    port has failed, and the trial ends. A subclass passes each message to `take`, either from this
    thread or from threads of the library.
    """

    @abstractmethod
    def connect(self) -> None:
        """Connect to the device. If this fails, raise an exception that says why."""

    def wait(self) -> None:
        """Wait for the next message and `take` it, if possible for at most about 0.1 s.

        This method is not needed if the library uses callbacks.
        """
        self._closing.wait(0.1)

    def disconnect(self) -> None:
        """Release the client.

        It is called once, even if `connect` has failed. Exceptions are ignored.
        """

    @property
    def name(self) -> str:
        """The name of the port, as the spec gives it."""
        return self._name

    def take(self, message: bytes, waited_ns: int = 0) -> None:
        """Pass a received message on to the owner of the port.

        Args:
            message: The message.
            waited_ns: How long ago it arrived [ns].
        """
        self._on_received(message, self._clock.now() - waited_ns)

    def lost(self, why: object) -> None:
        """Report that the connection has failed for the reason `why`.

        No more messages will come.
        """
        self._end(f"{self._device}: {why}")

    def open(self, alone: bool = True) -> None:
        """Start the thread that connects and receives messages."""
        self._thread.start()

    def write(self, data: bytes) -> int:
        """Send nothing, because messages arrive without a request. Returns the time [ns].

        Raises:
            AbortError: If the port has failed.
        """
        if self.failure:
            raise AbortError(self.failure, self._hint)
        return self._clock.now()

    def _read(self) -> None:
        try:
            self.connect()
            while not (self._closing.is_set() or self.failure):
                self.wait()
        except AbortError as error:
            self._end(error.message)
        except Exception as error:  # of a library, of which nothing is known
            self.lost(str(error) or type(error).__name__)
        with suppress(Exception):
            self.disconnect()
