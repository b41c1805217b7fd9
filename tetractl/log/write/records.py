"""What takes the records of a log: a file, or a digest alone."""

from collections.abc import Iterable, Mapping
from typing import Protocol

from tetractl.log.format.channels import Entry


class Records(Protocol):
    """Where the records of a log go: `sink.Sink` describes each method."""

    def messages(self, entries: Iterable[Entry]) -> None:
        """Add messages."""
        ...

    def metadata(self, name: str, items: Mapping[str, str]) -> None:
        """Add a metadata record."""
        ...

    def last_host_metadata(self, name: str, items: Mapping[str, str]) -> None:
        """Add the host record that states the digest of all host records."""
        ...

    def last_metadata(self, name: str, items: Mapping[str, str]) -> None:
        """Add the record that states the content digest."""
        ...

    def attachment(self, name: str, media_type: str, unix_ns: int, data: bytes) -> None:
        """Add an attachment."""
        ...

    def flush(self) -> None:
        """End the chunk."""
        ...

    def sync(self) -> None:
        """Wait until the disk has every record so far."""
        ...
