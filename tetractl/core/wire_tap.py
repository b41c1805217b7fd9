"""Where raw datagrams and serial bytes can be recorded as they pass."""

from typing import Protocol


class Tap(Protocol):
    """Is called with all bytes that pass on a wire, such as "natnet" or "radio".

    A call must return at once and never raise.
    """

    def received(self, wire: str, t_ns: int, data: bytes) -> None:
        """These bytes came at this time [ns on the run's clock]."""
        ...

    def sent(self, wire: str, t_ns: int, data: bytes) -> None:
        """These bytes left at this time [ns on the run's clock]."""
        ...


class NoTap:
    """Records nothing."""

    def received(self, wire: str, t_ns: int, data: bytes) -> None:
        """Do nothing."""

    def sent(self, wire: str, t_ns: int, data: bytes) -> None:
        """Do nothing."""


NO_TAP = NoTap()
