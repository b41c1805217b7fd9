"""Where raw datagrams and serial bytes can be listened to as they pass."""

from typing import Protocol


class Tap(Protocol):
    """Hears what passes on a wire, "natnet" or "radio"; must return at once and never raise."""

    def received(self, wire: str, t_ns: int, data: bytes) -> None:
        """These bytes came at this time [ns on the run's clock]."""
        ...

    def sent(self, wire: str, t_ns: int, data: bytes) -> None:
        """These bytes left at this time [ns on the run's clock]."""
        ...


class NoTap:
    """Hears nothing."""

    def received(self, wire: str, t_ns: int, data: bytes) -> None:
        """Do nothing."""

    def sent(self, wire: str, t_ns: int, data: bytes) -> None:
        """Do nothing."""


NO_TAP = NoTap()
