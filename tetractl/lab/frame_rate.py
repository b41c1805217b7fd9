"""The rate at which a camera's frames come."""

from collections.abc import Sequence
from typing import Protocol

from tetractl.core.clock import SECOND


class Numbered(Protocol):
    """A frame, or a picture that was searched: its number, and when it was received."""

    @property
    def number(self) -> int:
        """Number of the frame or picture."""
        ...

    @property
    def received_ns(self) -> int:
        """Time of arrival on the plant's clock [ns]."""
        ...


def rate_hz(frames: Sequence[Numbered]) -> float | None:
    """Return the rate of received frames [Hz], including those that are not among them; None for
    fewer than two.
    """
    if len(frames) < 2 or frames[-1].received_ns <= frames[0].received_ns:
        return None
    span = frames[-1].received_ns - frames[0].received_ns
    return (frames[-1].number - frames[0].number) * SECOND / span
