"""The interface of an open source of images, and the images that it delivers."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np


class SourceEndedError(Exception):
    """An error: the source of images has ended. The message contains the reason."""


@dataclass(frozen=True, slots=True)
class Picture:
    """An image that was received from a source.

    Attributes:
        content: A JPEG file, or pixels: (height, width) in grey or (height, width, 3) in colour.
        received_ns: When it arrived [ns].
    """

    content: np.ndarray | bytes
    received_ns: int


class Feed(Protocol):
    """An open source of images. One thread reads and closes it, and any thread may interrupt it.

    Sources derive from this class.

    Attributes:
        live: Whether the source delivers images even if they are not read.
        rate_hz: The source's declared rate [Hz]. None if unknown.
        emulated: Whether the source does not show real robots.
    """

    live: bool = True
    rate_hz: float | None = None
    emulated: bool = False

    @property
    def damaged(self) -> int:
        """Number of parts of the stream that could not be decoded so far. 0 by default."""
        return 0

    def read(self) -> Picture:
        """Wait for the next image.

        Raises:
            SourceEndedError: If the source has ended.
        """
        ...

    def interrupt(self) -> None:
        """End a `read` that waits in another thread. By default, nothing happens.

        A source whose `read` never waits for long need not override this method.
        """

    def close(self) -> None:
        """Release the source of images."""
        ...
