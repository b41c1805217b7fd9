"""Damaged copies of a log, and the properties that must hold for each."""

import random
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from mcap.records import Chunk
from mcap.stream_reader import StreamReader

from tetractl.core.errors import LogError
from tetractl.log.format.channels import Entry
from tetractl.log.read.reader import trial_of
from tetractl.log.read.salvage import MAGIC, scan


@dataclass
class Tally:
    """What came of many damaged copies."""

    copies: int = 0
    unreadable: int = 0
    chunks_complete: int = 0
    chunks_recovered: int = 0
    wrong: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class ChunkSpan:
    """Where one chunk lies in a file, in bytes from its first."""

    begin: int
    end: int  # behind its last byte


class Original:
    """An intact log and where its chunks are, by the official reader."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.data = path.read_bytes()
        self.contents = scan(path)
        self.records = {_key(record) for record in self.contents.records}
        self.chunks: list[ChunkSpan] = []
        with path.open("rb") as file:
            begin = len(MAGIC)
            for record in StreamReader(file, emit_chunks=True).records:
                if isinstance(record, Chunk):
                    self.chunks.append(ChunkSpan(begin, file.tell()))
                begin = file.tell()

    def truncated(self, count: int, rng: random.Random) -> Iterator[tuple[bytes, int]]:
        """Yield copies cut off anywhere, and how many chunks are complete in them."""
        for _ in range(count):
            cut = rng.randrange(len(self.data))
            yield self.data[:cut], sum(chunk.end <= cut for chunk in self.chunks)

    def flipped(self, count: int, rng: random.Random) -> Iterator[tuple[bytes, int]]:
        """Yield copies with one byte changed, and how many chunks are untouched in them."""
        for _ in range(count):
            offset = rng.randrange(len(self.data))
            mask = rng.randrange(1, 256)
            data = bytearray(self.data)
            data[offset] ^= mask
            untouched = [c for c in self.chunks if not c.begin <= offset < c.end]
            yield bytes(data), len(untouched)


def examine(original: Original, copy: Path, data: bytes, complete: int, tally: Tally) -> None:
    """Read one damaged copy; note every promise it breaks."""
    copy.write_bytes(data)
    tally.copies += 1
    tally.chunks_complete += complete
    try:
        contents = scan(copy)
    except LogError:
        tally.unreadable += 1
        if complete:
            tally.wrong.append("a good chunk in what is said to be no log")
        return
    tally.chunks_recovered += min(contents.chunks, complete)
    if contents.chunks < complete:
        tally.wrong.append(f"{complete - contents.chunks} good chunks not found")
    if not {_key(record) for record in contents.records} <= original.records:
        tally.wrong.append("a record that was never written")
    complete_records = len(contents.records) == len(original.contents.records)
    if not complete_records and not contents.problems:
        tally.wrong.append("records are lost and nothing is said")
    try:
        trial = trial_of(contents)
    except LogError:
        tally.unreadable += 1
        return
    is_whole = complete_records and contents.computed_digests.content == trial.digest
    if trial.damage is None and not is_whole:
        tally.wrong.append("a damaged trial is said to be whole")


def fuzz(original: Original, copies: Iterator[tuple[bytes, int]], scratch: Path) -> Tally:
    """Read many damaged copies."""
    tally = Tally()
    for data, complete in copies:
        examine(original, scratch, data, complete, tally)
    return tally


def _key(record: object) -> object:
    if isinstance(record, Entry):
        return record
    return repr(record)
