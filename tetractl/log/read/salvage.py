"""Finds every intact record of an MCAP file, however damaged the file is.

MCAP has checksums for chunks and attachments, and tetractl's metadata has its own, so each record
is verified by itself. The file is read from record to record; where a record is damaged, or the
checksum over the data section does not match, the file is also searched for further records.

A file may be hostile: the bytes that it can make tetractl unpack, copy and keep are bounded.
"""

import mmap
import re
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
from typing import IO, cast

import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    DataEnd,
    Footer,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

from tetractl.core.errors import LogError
from tetractl.log.format.channels import CHANNELS, METADATA, RUN, Entry
from tetractl.log.format.metadata import intact
from tetractl.log.read.contents import Contents

MAGIC = b"\x89MCAP0\r\n"
CHUNK_LIMIT = 1 << 24
"""Most bytes a chunk may unpack to; tetractl's have about a million."""
TOTAL_LIMIT = 1 << 32
"""Most bytes all chunks may unpack to: some ten hours of a trial."""
MESSAGE_LIMIT = 10_000_000
OVERLAP_LIMIT = 32
"""How many times the file's size may be read, by records that overlap."""
PROBLEM_LIMIT = 50

_HEAD = 9  # opcode and length, before the body of every record
_FOOTER_BODY = 20
_TRACES = re.compile(
    rb"(?P<chunk>\x04\0\0\0zstd)"
    rb"|(?P<metadata>[\0-\xff]\0\0\0tetractl\.(?:run|host|timing|result|recovered))"
    rb"|(?P<attachment>[\0-\xff]\0\0\0[ -~]{1,200}\x10\0\0\0application/(?:yaml|json))"
)
_TRACED = {  # opcode of the record that holds the trace, and bytes from its start to the trace
    "chunk": (Opcode.CHUNK, _HEAD + 28),
    "metadata": (Opcode.METADATA, _HEAD),
    "attachment": (Opcode.ATTACHMENT, _HEAD + 16),
}

Verified = Chunk | Attachment | Metadata
RawMessage = tuple[int, int, int, bytes]  # channel, log time, publish time, data
Inside = tuple[list[Schema], list[Channel], list[RawMessage]]

_MESSAGE = struct.Struct("<HIQQ")


def scan(path: Path) -> Contents:
    """Return every intact record of a file; LogError where it is no MCAP file."""
    with _opened(path) as data:
        return _Scan(path, data).contents()


def peek(path: Path) -> Contents | None:
    """Return metadata and attachments alone, found by the file's index; None for a damaged file."""
    with _opened(path) as data:
        return _Scan(path, data).indexed()


@contextmanager
def _opened(path: Path) -> Iterator[mmap.mmap]:
    try:
        with path.open("rb") as file:
            if path.stat().st_size == 0:
                raise LogError(f"{path}: the file is empty")
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
                yield data
    except OSError as error:
        why = "is a folder, not a log" if path.is_dir() else error.strerror or error
        raise LogError(f"{path}: {why}") from None


class _Scan:
    def __init__(self, path: Path, data: mmap.mmap) -> None:
        self._data = data
        self._result = Contents(path, size=len(data))
        self._problems = self._result.problems
        self._found: dict[int, Verified] = {}  # by offset in the file
        self._messages: dict[int, list[RawMessage]] = {}  # of the chunk at an offset
        self._topics: dict[int, str] = {}
        self._channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}
        self._read = self._unpacked = self._count = 0  # bytes, bytes, messages
        self._indexed: list[tuple[int, int]] = []  # offset and opcode, by the index
        self._expected: int | None = None  # messages, by the index

    def contents(self) -> Contents:
        """Read the file from record to record, search it where that fails, and sort the records."""
        begins = self._data[: len(MAGIC)] == MAGIC
        if not begins:
            self._problems.append("the file does not begin as an MCAP file")
        self._read_index()
        self._walk()
        if self._problems:
            self._search()
        if not (begins or self._found):
            raise LogError(f"{self._result.path}: not an MCAP file")
        self._collect()
        return self._result

    def indexed(self) -> Contents | None:
        """Read metadata and attachments by the file's index; None for a damaged file."""
        self._read_index()
        try:
            for offset, opcode in self._indexed:
                self._verify(offset, opcode)
        except Exception:  # as in _walk; the caller will scan
            return None
        if self._problems:
            return None
        self._collect()
        return self._result

    def _read_index(self) -> None:
        """Read the index at the end of the file: the number of messages, and where records are."""
        body = len(self._data) - len(MAGIC) - _FOOTER_BODY
        head = bytes([Opcode.FOOTER]) + _FOOTER_BODY.to_bytes(8, "little")
        whole = body >= _HEAD and self._data[-len(MAGIC) :] == MAGIC
        if not whole or self._data[body - _HEAD : body] != head:
            self._problems.append("the file breaks off: the index at its end is missing")
            return
        footer = Footer.read(self._stream(body))
        offset = footer.summary_start
        if offset > body or self._crc(offset, body + _FOOTER_BODY - 4) != footer.summary_crc:
            self._problems.append("the index at the end of the file is damaged")
            return
        while 0 < offset < body - _HEAD:
            opcode, end = self._head(offset)
            if opcode == Opcode.CHANNEL:
                channel = Channel.read(self._stream(offset + _HEAD))
                self._topics[channel.id] = channel.topic
            elif opcode == Opcode.STATISTICS:
                self._expected = Statistics.read(self._stream(offset + _HEAD)).message_count
            elif opcode == Opcode.METADATA_INDEX:
                index = MetadataIndex.read(self._stream(offset + _HEAD))
                self._indexed.append((index.offset, Opcode.METADATA))
            elif opcode == Opcode.ATTACHMENT_INDEX:
                index = AttachmentIndex.read(self._stream(offset + _HEAD))
                self._indexed.append((index.offset, Opcode.ATTACHMENT))
            offset = end

    def _walk(self) -> None:
        """Verify record after record of the data section."""
        offset = len(MAGIC)
        while offset + _HEAD <= len(self._data):
            opcode, end = self._head(offset)
            if end > len(self._data) or opcode == 0:  # zeros are what a power cut leaves
                break
            if opcode == Opcode.DATA_END:
                stated = DataEnd.read(self._stream(offset + _HEAD)).data_section_crc
                if stated and stated != self._crc(0, offset):
                    self._problems.append("the checksum of the data section does not match")
                return
            try:
                self._verify(offset, opcode)
            except Exception as error:  # zstd, UTF-8, struct, MCAP: they have no other ancestor
                why = str(error).splitlines()[0] if str(error) else type(error).__name__
                if len(self._problems) < PROBLEM_LIMIT:
                    self._problems.append(f"the record at byte {offset} is damaged: {why}")
            offset = end
        self._problems.append(f"the file breaks off in the record at byte {offset}")

    def _search(self) -> None:
        """Find records by typical bytes in them, whatever the bytes around them are."""
        for match in _TRACES.finditer(self._data):
            opcode, before = _TRACED[match.lastgroup or ""]
            offset = match.start() - before
            if offset >= 0 and offset not in self._found:
                with suppress(Exception):  # damaged, or bytes that only look like a record
                    self._verify(offset, opcode)

    def _verify(self, offset: int, opcode: int) -> None:
        """Decode and keep the record at an offset; raise where its checksum does not match."""
        if self._read > OVERLAP_LIMIT * len(self._data):
            raise ValueError("too many records claim the same bytes")
        stream = self._stream(offset + _HEAD)
        try:
            self._keep(offset, opcode, stream)
        finally:
            self._read += self._data.tell() - offset

    def _keep(self, offset: int, opcode: int, stream: ReadDataStream) -> None:
        if opcode == Opcode.CHUNK:
            chunk = Chunk.read(stream)
            schemas, channels, messages = self._unpack(chunk)
            self._schemas |= {item.id: item for item in schemas}
            self._channels |= {item.id: item for item in channels}
            self._topics |= {item.id: item.topic for item in channels}
            self._messages[offset] = messages
            self._found[offset] = chunk
        elif opcode == Opcode.ATTACHMENT:
            attachment = Attachment.read(stream)
            builder, end = RecordBuilder(), self._data.tell()
            attachment.write(builder)
            if builder.end()[-4:] != self._data[end - 4 : end]:
                raise ValueError("its checksum does not match")
            self._found[offset] = attachment
        elif opcode == Opcode.METADATA:
            metadata = Metadata.read(stream)
            if metadata.name.startswith("tetractl.") and not intact(metadata.metadata):
                raise ValueError("its checksum does not match")
            self._found[offset] = metadata

    def _unpack(self, chunk: Chunk) -> Inside:
        size = chunk.uncompressed_size
        if chunk.compression == "zstd":  # zstd ignores a limit where the frame states its size
            size = max(size, zstandard.frame_content_size(chunk.data))
        elif chunk.compression:
            raise ValueError(f"its compression {chunk.compression[:20]!r} is not known")
        if size > CHUNK_LIMIT:
            raise ValueError(f"it claims to unpack to {size} bytes")
        self._unpacked += size
        if self._unpacked > TOTAL_LIMIT or self._count > MESSAGE_LIMIT:
            raise ValueError("with it the log holds more than tetractl reads")
        if chunk.uncompressed_crc == 0:
            raise ValueError("it has no checksum")
        data = chunk.data
        if chunk.compression:
            data = zstandard.decompress(data, max_output_size=max(size, 1))
        if len(data) != chunk.uncompressed_size or zlib.crc32(data) != chunk.uncompressed_crc:
            raise ValueError("its checksum does not match")
        inside = _inside(data)
        self._count += len(inside[2])
        return inside

    def _collect(self) -> None:
        """Sort the records found into file order, and count the messages that are missing."""
        result = self._result
        names = {item.name for item in self._found.values() if isinstance(item, Metadata)}
        if not self._topics and RUN in names:  # the first chunk and the index are lost
            self._topics = dict(enumerate(CHANNELS, start=1))
        for offset, record in sorted(self._found.items()):
            if isinstance(record, Metadata) and record.name not in METADATA and self._problems:
                continue  # it may be damaged: another program's, without a checksum
            if isinstance(record, Chunk):
                result.chunks += 1
                result.records += [
                    Entry(self._topics[channel], log_ns, publish_ns, data)
                    for channel, log_ns, publish_ns, data in self._messages[offset]
                    if channel in self._topics
                ]
            else:
                result.records.append(record)
        result.channels = {
            channel.topic: (channel, self._schemas.get(channel.schema_id))
            for channel in self._channels.values()
        }
        if self._expected is None:
            result.lost.append("the messages of every missing or damaged chunk")
        elif missing := self._expected - len(result.entries):
            result.lost.append(f"{missing} of {self._expected} messages")

    def _head(self, offset: int) -> tuple[int, int]:
        """Return opcode and end of the record at an offset."""
        length = int.from_bytes(self._data[offset + 1 : offset + _HEAD], "little")
        return self._data[offset], offset + _HEAD + length

    def _stream(self, offset: int) -> ReadDataStream:
        self._data.seek(offset)
        return ReadDataStream(cast(IO[bytes], self._data))

    def _crc(self, start: int, end: int) -> int:
        with memoryview(self._data) as view:
            return zlib.crc32(view[start:end])


def _inside(data: bytes) -> Inside:
    """Return schemas, channels and messages of an unpacked chunk."""
    schemas, channels, messages = [], [], []
    offset, end = 0, len(data)
    while offset < end:
        opcode = data[offset]
        body = offset + _HEAD
        offset = body + int.from_bytes(data[offset + 1 : body], "little")
        if offset > end or opcode == 0:
            raise ValueError("it holds a record that does not fit into it")
        if opcode == Opcode.MESSAGE:
            channel, _, log_ns, publish_ns = _MESSAGE.unpack_from(data, body)
            messages.append((channel, log_ns, publish_ns, data[body + _MESSAGE.size : offset]))
        elif opcode == Opcode.CHANNEL:
            channels.append(Channel.read(ReadDataStream(BytesIO(data[body:offset]))))
        elif opcode == Opcode.SCHEMA:
            schemas.append(Schema.read(ReadDataStream(BytesIO(data[body:offset]))))
    return schemas, channels, messages
