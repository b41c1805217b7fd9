"""Reads a recorded wire as logs are read: checksums are tested and every size is bounded."""

from collections.abc import Iterator
from pathlib import Path

from tetractl.core.errors import LogError
from tetractl.lab.recorder import Passage
from tetractl.log.read.salvage import scan

_TOPICS = {f"/{wire}/{way}" for wire in ("natnet", "radio") for way in ("received", "sent")}


def read_wire(path: Path) -> Iterator[Passage]:
    """Yield the recorded passages, oldest first; LogError for a damaged file or another's."""
    contents = scan(path)
    if wrong := [*contents.problems, *contents.lost]:
        raise LogError(f"{path}: not a recorded wire, or damaged: {wrong[0]}")
    if contents.channels.keys() - _TOPICS:
        raise LogError(f"{path}: not a recorded wire: it has other channels")
    for entry in sorted(contents.entries, key=lambda entry: entry.log_ns):
        _, wire, way = entry.topic.split("/")
        yield Passage(wire, way == "received", entry.log_ns, entry.data)
