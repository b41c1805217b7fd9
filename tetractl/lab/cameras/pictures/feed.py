"""What an open source of pictures does, and what comes out of it."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np


class SourceEndedError(Exception):
    """No picture will come any more; the message is a clause that says why."""


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture as it came: pixels (height, width, 3) or a JPEG file, and its time of arrival."""

    content: np.ndarray | bytes
    received_ns: int


class Feed(Protocol):
    """An open source. One thread reads and closes; any may interrupt.

    Pictures of a `live` source come whether they are read or not. `rate_hz` is what it promises,
    None if it promises nothing. An `emulated` source does not show real robots.
    """

    live: bool
    rate_hz: float | None
    emulated: bool

    @property
    def damaged(self) -> int:
        """Parts of a stream that could not be read; only grows."""
        ...

    def read(self) -> Picture:
        """Wait for the next picture; SourceEndedError if none will come."""
        ...

    def interrupt(self) -> None:
        """Interrupt a waiting `read`."""
        ...

    def close(self) -> None:
        """Release the source."""
        ...
