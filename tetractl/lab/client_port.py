"""The base of ports to what is no port: the client of a maker's library, or another process."""

from abc import ABC, abstractmethod
from contextlib import suppress

from tetractl.core.errors import AbortError
from tetractl.lab.serial_port import SerialPort


class ClientPort(SerialPort, ABC):
    """A client that receives messages without asking for them, used like a port called `name`.

    A thread calls `connect`, then `wait` until the port is closed, then `disconnect`. If one of
    them raises an exception, or calls `lost`, the port ends, and with it the trial. Messages go to
    `take`, from this thread or from threads of the library.
    """

    @abstractmethod
    def connect(self) -> None:
        """Connect; any exception says why that failed."""

    def wait(self) -> None:
        """Wait for the next message and `take` it, if possible for at most about 0.1 s.

        This method is not needed if the library uses callbacks.
        """
        self._closing.wait(0.1)

    def disconnect(self) -> None:
        """Release the client; called once, even if `connect` has failed. Exceptions are ignored."""

    @property
    def name(self) -> str:
        """What the spec calls the port."""
        return self._name

    def take(self, message: bytes, waited_ns: int = 0) -> None:
        """Pass on a message that came `waited_ns` ago."""
        self._on_received(message, self._clock.now() - waited_ns)

    def lost(self, why: object) -> None:
        """Say that nothing more will come."""
        self._end(f"{self._device}: {why}")

    def open(self, alone: bool = True) -> None:
        """Start the thread."""
        self._thread.start()

    def write(self, data: bytes) -> int:
        """Do nothing, because messages arrive without a request.

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
