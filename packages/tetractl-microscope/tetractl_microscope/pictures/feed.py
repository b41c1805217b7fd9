"""The interface of an opened source of pictures, and the pictures that it delivers."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np


class SourceEndedError(Exception):
    """The source has ended and delivers no more pictures; the message states the reason."""


@dataclass(frozen=True, slots=True)
class Picture:
    """A received image.

    Attributes:
        content: A JPEG file, or pixels: (height, width) in grey or (height, width, 3) in colour.
        received_ns: When it arrived [ns].
    """

    content: np.ndarray | bytes
    received_ns: int


class Feed(Protocol):
    """An opened source of pictures. One thread reads and closes it; any thread may interrupt.

    Feeds derive from this class. A `live` source delivers pictures even if they are not read.
    `rate_hz` is the source's declared rate [Hz], None if unknown. An `emulated` source does not
    show real robots.
    """

    live: bool = True
    rate_hz: float | None = None
    emulated: bool = False

    @property
    def damaged(self) -> int:
        """Number of parts of the stream so far that could not be read."""
        return 0

    def read(self) -> Picture:
        """Wait for the next image.

        Raises:
            SourceEndedError: If the source has ended.
        """
        ...

    def interrupt(self) -> None:
        """End a `read` that is waiting in another thread; unneeded if no wait is long."""

    def close(self) -> None:
        """Release the source."""
        ...
