"""Finds every intact record of an MCAP file, however damaged the file is.

MCAP has checksums for chunks and attachments, so each record is verified by itself. The file is
read from record to record; if a record is damaged, or the checksum over the data section does not
match, the file is also searched for further records.

A file may be malicious: the bytes unpacked, copied and kept are subtracted from a budget.
"""

import re
import struct
import zlib
from io import BytesIO
from pathlib import Path

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    Schema,
    Statistics,
)

from tetractl.core.errors import LogError, printable
from tetractl.log.format.channels import CHANNELS, SUMMARY, Entry
from tetractl.log.read import limits
from tetractl.log.read.limits import TooMuchError
from tetractl.log.read.raw_log import RawLog, read_file

MAGIC = b"\x89MCAP0\r\n"

_HEAD = 9  # opcode and length, before the body of every record
_FOOTER_BODY = 20
_DATA_END_BODY = 4
_COMPRESSION = re.compile(b"\x04\0\0\0zstd")
"""Bytes in each chunk of tetractl: the length of its compression's name, and the name."""
_KIND = re.compile(b"\x10\0\0\0application/")
"""Bytes with which the media type of each attachment of tetractl begins: its length and first
word.
"""
_NAME_MAX = 200

RawMessage = tuple[int, int, int, bytes]  # channel, log time, publish time, data
Verified = list[RawMessage] | Attachment  # a record; of a chunk, its messages
Inside = tuple[list[Schema], list[Channel], list[RawMessage]]

_MESSAGE = struct.Struct("<HIQQ")
_TOPICS = dict(enumerate(CHANNELS, start=1))  # by the number of a channel


def peek(path: Path) -> RawLog | None:
    """Return only attachments and the chunks with the messages of the run and its result, found by
    the file's index, in a third of the time of `scan`; None for a damaged file.

    Two checksums are tested, which together cover the whole file: of the data section and of the
    index.
    """
    try:
        return _Scan(path).indexed()
    except TooMuchError:
        return None


def scan(path: Path) -> RawLog:
    """Return every intact record of a file.

    Raises LogError if it is not an MCAP file, or needs more memory than `limits` allows.
    """
    try:
        return _Scan(path).contents()
    except TooMuchError as error:
        raise LogError(f"{path}: {error}") from None


class _Scan:
    def __init__(self, path: Path) -> None:
        self._data, size, problem = read_file(path)
        self._file = BytesIO(self._data)
        self._result = RawLog(path, size=size)
        self._spend = self._result.budget.spend
        self._spend(len(self._data), "very many bytes")
        self._problems = self._result.problems
        if problem:
            self._problems.append(problem)
        self._found: dict[int, Verified] = {}  # records by offset in the file
        self._channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}
        self._read = 0  # number of bytes decoded
        self._indexed: list[tuple[int, int]] = []  # offsets and opcodes in the index
        self._summary = 0  # offset of the index
        self._expected: int | None = None  # number of messages stated in the index

    def contents(self) -> RawLog:
        """Read the file record by record, search it if it is damaged, and sort the records."""
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

    def indexed(self) -> RawLog | None:
        """Read what `peek` returns; None for a damaged file."""
        self._read_index(channels=False)
        if self._problems or not self._sealed():
            return None
        if any(self._verify(offset, opcode) for offset, opcode in self._indexed):
            return None
        self._collect()
        return self._result

    def _sealed(self) -> bool:
        """Return whether the data section has a checksum, and the checksum matches."""
        offset = self._summary - _HEAD - _DATA_END_BODY
        head = bytes([Opcode.DATA_END]) + _DATA_END_BODY.to_bytes(8, "little")
        if offset < len(MAGIC) or self._data[offset : offset + _HEAD] != head:
            return False
        stated = DataEnd.read(self._stream(offset + _HEAD)).data_section_crc
        return stated != 0 and stated == self._crc(0, offset)

    def _read_index(self, channels: bool = True) -> None:
        """Read the index at the end of the file: the number of messages, and the offsets of the
        records that `peek` reads. With `channels`, it also reads the channels and schemas that
        messages need, which takes most of the time.
        """
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
        self._summary = offset
        while 0 < offset < body - _HEAD:
            opcode, end = self._head(offset)
            self._spend(limits.RECORD_COST, "very many records in the file's index")
            if opcode == Opcode.CHANNEL and channels:
                channel = Channel.read(self._stream(offset + _HEAD))
                self._channels[channel.id] = channel  # the chunk with this record may be lost
            elif opcode == Opcode.SCHEMA and channels:
                schema = Schema.read(self._stream(offset + _HEAD))
                self._schemas[schema.id] = schema
            elif opcode == Opcode.STATISTICS:
                self._expected = Statistics.read(self._stream(offset + _HEAD)).message_count
            elif opcode == Opcode.CHUNK_INDEX and not channels:
                chunk = ChunkIndex.read(self._stream(offset + _HEAD))
                if SUMMARY & {_TOPICS.get(number) for number in chunk.message_index_offsets}:
                    self._indexed.append((chunk.chunk_start_offset, Opcode.CHUNK))
            elif opcode == Opcode.ATTACHMENT_INDEX:
                index = AttachmentIndex.read(self._stream(offset + _HEAD))
                self._indexed.append((index.offset, Opcode.ATTACHMENT))
            offset = end

    def _walk(self) -> None:
        """Verify each record of the data section, in order."""
        offset = len(MAGIC)
        while offset + _HEAD <= len(self._data):
            opcode, end = self._head(offset)
            if end > len(self._data) or opcode == 0:  # a power cut leaves zeros
                break
            if opcode == Opcode.DATA_END:
                stated = DataEnd.read(self._stream(offset + _HEAD)).data_section_crc
                if stated and stated != self._crc(0, offset):
                    self._problems.append("the checksum of the data section does not match")
                return
            why = self._verify(offset, opcode)
            if why and len(self._problems) < limits.PROBLEMS_MAX:
                self._problems.append(f"the record at byte {offset} is damaged: {why}")
            offset = end
        self._problems.append(f"the file breaks off in the record at byte {offset}")

    def _search(self) -> None:
        """Find further records anywhere in the file, by bytes that records of their kind
        contain.
        """
        for found in re.finditer(_COMPRESSION, self._data):
            self._try(found.start() - 28 - _HEAD, Opcode.CHUNK)
        for found in re.finditer(_KIND, self._data):
            for length in range(1, _NAME_MAX):
                name = found.start() - length - 4
                if self._data[name : name + 4] == length.to_bytes(4, "little"):
                    self._try(name - 16 - _HEAD, Opcode.ATTACHMENT)

    def _try(self, offset: int, opcode: int) -> None:
        if offset >= 0 and offset not in self._found:  # else bytes that look like a record
            self._verify(offset, opcode)

    def _verify(self, offset: int, opcode: int) -> str:
        """Decode and keep the record at an offset; return the reason if that fails, else ""."""
        self._spend(limits.RECORD_COST, "very many records")
        if self._read > limits.OVERLAP * len(self._data):
            return "too many records claim the same bytes"
        stream = self._stream(offset + _HEAD)
        try:
            self._keep(offset, opcode, stream, self._head(offset)[1])
        except TooMuchError:
            raise
        except Exception as error:  # errors of zstd, UTF-8, struct and MCAP
            return str(error).splitlines()[0] if str(error) else type(error).__name__
        finally:
            self._read += _HEAD + stream.count
        return ""

    def _keep(self, offset: int, opcode: int, stream: ReadDataStream, end: int) -> None:
        size = end - offset
        if opcode == Opcode.CHUNK:
            schemas, channels, messages = self._unpack(Chunk.read(stream))
            self._schemas |= {item.id: item for item in schemas}
            self._channels |= {item.id: item for item in channels}
            self._found[offset] = messages
        elif opcode == Opcode.ATTACHMENT:
            if size > limits.RECORD_MAX:
                raise ValueError(f"an attachment of {size} bytes is more than tetractl reads")
            attachment = Attachment.read(stream)
            stated = int.from_bytes(self._data[end - 4 : end], "little")
            if stated != self._crc(offset + _HEAD, end - 4):
                raise ValueError("the attachment's checksum does not match")
            self._spend(size, "very large attachments")
            self._found[offset] = attachment
        elif opcode == Opcode.METADATA:
            self._result.metadata.append(Metadata.read(stream))
        elif opcode == Opcode.HEADER:
            self._result.library = printable(Header.read(stream).library, _NAME_MAX)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL) or opcode > max(Opcode):
            self._result.strange = [*self._result.strange[-limits.PROBLEMS_MAX :], opcode]

    def _unpack(self, chunk: Chunk) -> Inside:
        schemas, channels, messages = unpack(chunk)
        self._spend(chunk.uncompressed_size, "chunks that unpack to very many bytes")
        self._spend(limits.RECORD_COST * (len(schemas) + len(channels)), "very many channels")
        self._spend(limits.MESSAGE_COST * len(messages), "very many messages")
        return schemas, channels, messages

    def _collect(self) -> None:
        """Sort the records found into file order, and count the messages that are missing."""
        result = self._result
        topics = {number: channel.topic for number, channel in self._channels.items()} or _TOPICS
        for _, record in sorted(self._found.items(), key=lambda item: item[0]):
            if isinstance(record, Attachment):
                result.records.append(record)
                continue
            result.chunks += 1
            result.records += [
                Entry(topics[channel], log_ns, publish_ns, data)
                for channel, log_ns, publish_ns, data in record
                if channel in topics
            ]
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
        self._file.seek(offset)
        return ReadDataStream(self._file)

    def _crc(self, start: int, end: int) -> int:
        with memoryview(self._data) as view:
            return zlib.crc32(view[start:end])


def unpack(chunk: Chunk) -> Inside:
    """Return schemas, channels and messages of a chunk; an error of ValueError, zstd or lz4 for one
    that is damaged, too large or without a checksum.
    """
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":  # zstd ignores a limit if the frame states its size
        size = max(size, zstandard.frame_content_size(chunk.data))
    elif chunk.compression not in ("", "lz4"):
        raise ValueError(f"the chunk's compression {chunk.compression[:20]!r} is not known")
    if size > limits.CHUNK_MAX:
        raise ValueError(f"the chunk claims to unpack to {size} bytes")
    if chunk.uncompressed_crc == 0:
        raise ValueError("the chunk has no checksum")
    data = chunk.data
    if chunk.compression == "lz4":  # by other writers
        data = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    elif chunk.compression:
        data = zstandard.decompress(data, max_output_size=max(size, 1))
    if len(data) != chunk.uncompressed_size or zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("the chunk's checksum does not match")
    return _inside(data)


def _inside(data: bytes) -> Inside:
    """Return schemas, channels and messages of an unpacked chunk."""
    schemas, channels, messages = [], [], []
    offset, end = 0, len(data)
    while offset < end:
        opcode = data[offset]
        body = offset + _HEAD
        offset = body + int.from_bytes(data[offset + 1 : body], "little")
        if offset > end or opcode == 0:
            raise ValueError("the chunk contains an invalid record")
        if opcode == Opcode.MESSAGE:
            channel, _, log_ns, publish_ns = _MESSAGE.unpack_from(data, body)
            messages.append((channel, log_ns, publish_ns, data[body + _MESSAGE.size : offset]))
        elif opcode == Opcode.CHANNEL:
            channels.append(Channel.read(ReadDataStream(BytesIO(data[body:offset]))))
        elif opcode == Opcode.SCHEMA:
            schemas.append(Schema.read(ReadDataStream(BytesIO(data[body:offset]))))
    return schemas, channels, messages
