"""Finds every intact record of an MCAP file, however damaged the file is.

MCAP has checksums for chunks and attachments, so each is verified by itself. The file is read from
record to record; if a record is damaged, or the checksum over the data section does not match, the
file is also searched for further chunks and attachments.

What decodes a record gets the bytes of this record only, and all of the reading of a file counts
towards one limit of processor time: records that claim to be longer than they are, or very many of
them, could otherwise keep a reader busy for hours.
"""

import re
import struct
import time
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Header, Metadata, Schema

from tetractl.core.errors import LogError, printable
from tetractl.log.format.channels import NUMBERS, SUMMARY, WRITER, Entry
from tetractl.log.read.limits import CHUNK_MAX, file_limit, seconds_limit, too_much
from tetractl.log.read.raw_log import RawLog, read_file

MAGIC = b"\x89MCAP0\r\n"
PROBLEMS_MAX = 50
"""Largest number of damaged records of a log that are listed."""

_HEAD = struct.Struct("<BQ")  # opcode and length, before the contents of every record
_MESSAGE = struct.Struct("<HIQQ")
_FOOTER = bytes([Opcode.FOOTER]) + (20).to_bytes(8, "little")
_TOPICS = {number: topic for topic, number in NUMBERS.items()}
UNSTATED = 0
"""What MCAP writes in place of a checksum that is left out."""
_SUMMARY = {NUMBERS[topic] for topic in SUMMARY}
_CHUNK_HEAD = 44
"""Length of what stands in a chunk before its packed records, if its compression is zstd: two
times, a length, a checksum, the word zstd behind its own length, and the length of the records."""
_IN_CHUNKS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
_MARKS = (
    (Opcode.CHUNK, re.compile(b"\x04\0\0\0zstd"), -28),
    (Opcode.ATTACHMENT, re.compile(rb"\x09(?=.{3}\0{5})", re.DOTALL), _HEAD.size),
)
"""How a record is found whose place is not known: bytes that it has, and where its contents begin
from there. Of a chunk, they are its compression, so that its head may be damaged."""

RawMessage = tuple[int, int, int, bytes]  # channel, log time, publish time, data


def records(data: bytes, offset: int = 0) -> Iterator[tuple[int, int, int]]:
    """Yield the opcode of each record, and where its contents begin and end, up to one that is cut
    off; a power cut leaves zeros."""
    while offset + _HEAD.size <= len(data):
        opcode, length = _HEAD.unpack_from(data, offset)
        begin = offset + _HEAD.size
        offset = begin + length
        if offset > len(data) or opcode == 0:
            return
        yield opcode, begin, offset


def peek(path: Path) -> RawLog | None:
    """Return only attachments and the chunks with the messages of the run and its result, in a
    third of the time of `scan`; None for a damaged file. Raises as `scan` does.

    Two checksums are tested, which together cover the whole file: of the data section and of the
    index.
    """
    return _Scan(path).summary()


def scan(path: Path) -> RawLog:
    """Return every intact record of a file.

    Raises LogError if it is not an MCAP file, or exceeds the `limits`.
    """
    return _Scan(path).whole()


@dataclass
class _Records:
    """The intact records found in a file so far; chunks and attachments by their offset."""

    by_offset: dict[int, list[RawMessage] | Attachment] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    metadata: list[Metadata] = field(default_factory=list)
    strange: set[int] = field(default_factory=set)  # opcodes that no log has outside chunks
    library: str = ""
    foreign: bool = False  # another program wrote it, and may have left out index and checksums
    size: int = 0  # bytes


class _Scan:
    """One reading of a file: verifies its records, keeps the intact ones, and lists problems."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._data = read_file(path)
        self._until_s = time.thread_time() + seconds_limit()
        self._records = _Records()
        self._problems: list[str] = []
        self._sealed = False  # the data section has a checksum

    def whole(self) -> RawLog:
        """Read the file record by record, search it if it is damaged, and sort the records."""
        begins = self._data.startswith(MAGIC)
        if not begins:
            self._problems.append("the file does not begin as an MCAP file")
        for opcode, begin, end in self._walk():
            why = self._verify(opcode, begin, end)
            if why and len(self._problems) < PROBLEMS_MAX:
                offset = begin - _HEAD.size
                self._problems.append(f"the record at byte {offset} is damaged: {why}")
        expected = self._read_index()
        if self._problems:
            self._search()
        if not (begins or self._records.by_offset):
            raise LogError(f"{self._path}: not an MCAP file")
        result = self._collected()
        result.lost.extend(self._lost(result, expected))
        return result

    def summary(self) -> RawLog | None:
        """Read what `peek` returns; None for a damaged file, or one that others wrote."""
        wanted: set[tuple[int, int, int]] = set()
        chunk: tuple[int, int, int] | None = None  # the last one
        for record in self._walk():
            opcode, begin, _ = record
            if opcode == Opcode.CHUNK:
                chunk = record
            elif opcode == Opcode.MESSAGE_INDEX and self._number(begin, 2) in _SUMMARY:
                if chunk is not None:
                    wanted.add(chunk)
            elif opcode == Opcode.ATTACHMENT:
                wanted.add(record)
            elif opcode == Opcode.MESSAGE:  # outside a chunk
                return None
        self._read_index()
        if self._problems or not self._sealed:
            return None
        if any(self._verify(*record) for record in sorted(wanted)):
            return None
        return self._collected()

    def _lost(self, result: RawLog, expected: int | None) -> list[str]:
        """Return what the file has lost, if its index states an `expected` number of messages."""
        if expected is None:
            return ["the messages of every missing or damaged chunk"] if self._problems else []
        missing = expected - len(result.entries)
        return [f"{missing} of {expected} messages"] if missing else []

    def _walk(self) -> Iterator[tuple[int, int, int]]:
        """Yield the opcode of each record of the data section, and where its contents begin and
        end."""
        cut = len(MAGIC)
        for opcode, begin, end in records(self._data, cut):
            self._require_time()
            if opcode == Opcode.DATA_END:
                stated = self._number(begin)
                self._sealed = stated != 0
                if end - begin != 4:
                    self._problems.append("the end of the data section has a wrong length")
                elif self._sealed and stated != self._crc(0, begin - _HEAD.size):
                    self._problems.append("the checksum of the data section does not match")
                return
            yield opcode, begin, end
            cut = end
        self._problems.append(f"the file breaks off in the record at byte {cut}")

    def _read_index(self) -> int | None:
        """Return the number of messages that the index at the file's end states, None if the index
        is damaged, or left out; of a damaged file, read the channels in it, as the chunk with the
        record of a channel may be lost.
        """
        footer = len(self._data) - len(MAGIC) - 20
        head = self._data[max(0, footer - len(_FOOTER)) : footer]
        if head != _FOOTER or not self._data.endswith(MAGIC):
            self._problems.append("the file breaks off: the index at its end is missing")
            return None
        index = self._number(footer, 8)
        if index == 0 and self._records.foreign:
            return None
        if index > footer or not self._matches(index, footer + 16):
            self._problems.append("the index at the end of the file is damaged")
            return None
        expected = None
        for opcode, begin, end in records(self._data, index) if index else ():
            self._require_time()
            if opcode == Opcode.STATISTICS:
                expected = self._number(begin, 8)
            elif self._problems:
                with suppress(Exception):  # errors of UTF-8 and MCAP
                    self._know(opcode, self._data[begin:end])
        return expected

    def _search(self) -> None:
        """Find further records anywhere in the file, by bytes that records of their kind
        contain.
        """
        for opcode, mark, away in _MARKS:
            for match in mark.finditer(self._data):
                self._require_time()
                begin = match.start() + away
                if begin > 0 and begin not in self._records.by_offset:
                    # mostly bytes that only look like a record
                    self._verify(opcode, begin, self._end(opcode, begin))

    def _end(self, opcode: int, begin: int) -> int:
        """Return where a chunk or an attachment ends, by the lengths of its parts, as the length in
        its head may be damaged."""
        if opcode == Opcode.CHUNK:
            packed = begin + _CHUNK_HEAD
            return packed + self._number(packed - 8, 8)
        name = begin + 20  # after two times and a length
        media_type = name + self._number(name - 4) + 4
        data = media_type + self._number(media_type - 4) + 8
        return data + self._number(data - 8, 8) + 4

    def _verify(self, opcode: int, begin: int, end: int) -> str:
        """Decode and keep a record; return the reason if that fails, else ""."""
        try:
            self._keep(opcode, begin, self._data[begin:end])
        except LogError:
            raise
        except Exception as error:  # errors of zstd, UTF-8, struct and MCAP
            message = str(error)
            return message.splitlines()[0] if message else type(error).__name__
        return ""

    def _keep(self, opcode: int, begin: int, contents: bytes) -> None:
        if len(contents) > CHUNK_MAX and opcode not in (Opcode.CHUNK, Opcode.ATTACHMENT):
            raise ValueError(f"it has {len(contents)} bytes")
        stream = ReadDataStream(BytesIO(contents))
        if opcode == Opcode.CHUNK:
            data = unpack(Chunk.read(stream), self._records.foreign)
            self._records.by_offset[begin] = self._inside(data)
        elif opcode == Opcode.ATTACHMENT:
            attachment = Attachment.read(stream)
            crc = begin + stream.count - 4
            if not self._matches(begin, crc):
                raise ValueError("the attachment's checksum does not match")
            self._spend(stream.count)
            self._records.by_offset[begin] = attachment
        elif opcode == Opcode.METADATA:
            self._spend(len(contents) + 256)
            self._records.metadata.append(Metadata.read(stream))
        elif opcode == Opcode.HEADER:
            self._records.library = printable(Header.read(stream).library, 200)
            self._records.foreign = not self._records.library.startswith(WRITER)
        elif opcode in _IN_CHUNKS or opcode > max(Opcode):
            self._records.strange.add(opcode)

    def _inside(self, data: bytes) -> list[RawMessage]:
        """Return the messages of an unpacked chunk; its schemas and channels are kept.

        MCAP's `breakup_chunk` takes more than twice the time for each message.
        """
        messages: list[RawMessage] = []
        count = 0
        end = 0
        for opcode, begin, end in records(data):
            count += 1
            if opcode == Opcode.MESSAGE:
                channel, _, log_ns, publish_ns = _MESSAGE.unpack_from(data, begin)
                message = data[begin + _MESSAGE.size : end]
                messages.append((channel, log_ns, publish_ns, message))
            else:
                self._know(opcode, data[begin:end])
        if end < len(data):
            raise ValueError("the chunk contains an invalid record")
        self._spend(len(data) + 256 * count)  # even an empty message takes memory
        return messages

    def _know(self, opcode: int, contents: bytes) -> None:
        if opcode == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(BytesIO(contents)))
            self._records.channels[channel.id] = channel
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(BytesIO(contents)))
            self._records.schemas[schema.id] = schema

    def _require_time(self) -> None:
        if time.thread_time() > self._until_s:
            raise too_much(self._path, "very many records, or very many damaged ones")

    def _spend(self, size: int) -> None:
        self._records.size += size
        if self._records.size > file_limit():
            raise too_much(self._path, "very many bytes or messages in its chunks")

    def _collected(self) -> RawLog:
        """Return the records found, in file order. The topic of each channel is that which its
        record states and, for records that are lost, that of the format for its number, unless a
        record that is left contradicts it.
        """
        topics = {number: channel.topic for number, channel in self._records.channels.items()}
        if all(_TOPICS.get(number, topic) == topic for number, topic in topics.items()):
            topics = _TOPICS | topics
        in_order: list[Entry | Attachment] = []
        chunks = 0
        for _, record in sorted(self._records.by_offset.items(), key=lambda item: item[0]):
            if isinstance(record, Attachment):
                in_order.append(record)
                continue
            chunks += 1
            in_order += [
                Entry(topics[channel], log_ns, publish_ns, data)
                for channel, log_ns, publish_ns, data in record
                if channel in topics
            ]
        return RawLog(
            self._path,
            size=len(self._data),
            records=in_order,
            chunks=chunks,
            problems=self._problems,
            channels={
                channel.topic: (channel, self._records.schemas.get(channel.schema_id))
                for channel in self._records.channels.values()
            },
            library=self._records.library,
            metadata=self._records.metadata,
            strange=frozenset(self._records.strange),
        )

    def _number(self, begin: int, size: int = 4) -> int:
        return int.from_bytes(self._data[begin : begin + size], "little")

    def _matches(self, begin: int, end: int) -> bool:
        """Return whether the checksum at `end` is that of the bytes before it."""
        stated = self._number(end)
        return stated == self._crc(begin, end) or (self._records.foreign and stated == UNSTATED)

    def _crc(self, begin: int, end: int) -> int:
        with memoryview(self._data) as view:
            return zlib.crc32(view[begin:end])


def unpack(chunk: Chunk, unsealed: bool = False) -> bytes:
    """Return the contents of a chunk; an error of ValueError, zstd or lz4 for one that is damaged,
    too large or, unless it may be `unsealed`, without a checksum.
    """
    data = chunk.data
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":  # zstd ignores a limit if the frame states its size
        size = max(size, zstandard.frame_content_size(data))
    if size > CHUNK_MAX:
        raise ValueError(f"the chunk claims to unpack to {size} bytes")
    if chunk.compression == "zstd":
        data = zstandard.decompress(data, max_output_size=max(size, 1))
    elif chunk.compression == "lz4":  # by other writers
        data = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    elif chunk.compression:
        raise ValueError(f"the chunk's compression {chunk.compression[:20]!r} is not known")
    stated = chunk.uncompressed_crc
    sealed = zlib.crc32(data) == stated or (unsealed and stated == UNSTATED)
    if len(data) != chunk.uncompressed_size or not sealed:
        raise ValueError("the chunk's checksum does not match")
    return data
