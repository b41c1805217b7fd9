"""Read a log file, however damaged it is, and find every record that is still intact.

A log is an MCAP file: a series of records. Each record consists of an opcode, the length of its
contents, and the contents. The messages of a trial are in chunks. Chunks and attachments have
checksums, so each can be verified separately. The file is read from record to record. If one of
them is damaged, or if the checksum over all of them does not match, the rest of the file is
searched for chunks and attachments.

Two measures protect the reader from records that claim to be longer than they are, and from very
many records, which could keep it busy for hours. The code that decodes a record gets only the bytes
of this record. And all reading of a file counts towards one limit of processor time.
"""

import re
import struct
import time
import zlib
from collections.abc import Iterator
from contextlib import suppress
from io import BytesIO
from pathlib import Path

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Header, Schema, Statistics

from tetractl.core.errors import LogError, printable
from tetractl.log.format.channels import MAGIC, NUMBERS, SUMMARY, WRITER, Entry, Record
from tetractl.log.read.limits import CHUNK_MAX, file_limit, limit_error, seconds_limit
from tetractl.log.read.raw_log import RawLog, read_file

PROBLEMS_MAX = 50
"""Maximum number of damaged records of a log that are listed."""
UNSTATED = 0
"""Value of an MCAP checksum field whose checksum was left out."""

_RECORD = struct.Struct("<BQ")
"""Layout of the beginning of every record: opcode, length of the contents."""
_MESSAGE = struct.Struct("<HIQQ")
"""Layout of the beginning of a message: channel, sequence, log time, publish time."""
_CHUNK_TIMES_AND_SIZE = struct.Struct("<QQQI")
"""Layout of a chunk's first fields: first and last time, size and checksum when unpacked."""
_CHUNK = struct.Struct(_CHUNK_TIMES_AND_SIZE.format + "I4sQ")
"""Layout of all fields before the packed records of a zstd chunk.

After the fields above come the length and name of the compression, and the packed size.
"""
_TIMES = struct.Struct("<QQ")
"""Layout of an attachment's first fields: log time and time of creation."""
_LENGTH = struct.Struct("<I")
_LONG_LENGTH = struct.Struct("<Q")
_CHECKSUM = struct.Struct("<I")
_FOOTER = struct.Struct("<QQI")
"""Layout of the last record: offset of the index, offset of the index's index, and checksum."""
_FOOTER_HEAD = _RECORD.pack(Opcode.FOOTER, _FOOTER.size)

_ZSTD = re.compile(_LENGTH.pack(4) + b"zstd")
"""Bytes that every chunk of tetractl contains after its times and size.

They are searched for, because the head of a chunk may be damaged.
"""
_SMALL_ATTACHMENT = re.compile(rb"\x09(?=.{3}\0{5})", re.DOTALL)
"""Bytes with which an attachment of less than 16 MiB begins."""
_TOPIC_BY_NUMBER = {number: topic for topic, number in NUMBERS.items()}
_SUMMARY_NUMBERS = {NUMBERS[topic] for topic in SUMMARY}

RawMessage = tuple[int, int, int, bytes]  # channel, log time, publish time, data


def records(data: bytes, offset: int = 0) -> Iterator[tuple[int, int, int]]:
    """Yield the opcode of each MCAP record, and the offsets at which its contents begin and end.

    The generator stops at a record that is cut off, or at zeros, which a power cut can leave.

    Args:
        data: Bytes that consist of records.
        offset: Where the first record begins.
    """
    while offset + _RECORD.size <= len(data):
        opcode, length = _RECORD.unpack_from(data, offset)
        begin_offset = offset + _RECORD.size
        offset = begin_offset + length
        if offset > len(data) or opcode == 0:
            return
        yield opcode, begin_offset, offset


def peek(path: Path) -> RawLog | None:
    """Read only the attachments of a log, and the chunks with the run and its result.

    This takes a third of the time of `scan`. Two checksums are tested, which together cover the
    whole file: one of the data section and one of the index.

    Returns:
        The contents. None for a damaged file, or for a file of another program.

    Raises:
        LogError: If the file exceeds the `limits`.
    """
    return _Scan(path).read_summary()


def scan(path: Path) -> RawLog:
    """Read every intact record of a log file, however damaged the file is.

    Damage is listed in `problems` and `lost`.

    Raises:
        LogError: If the file is not an MCAP file, or exceeds the `limits`.
    """
    return _Scan(path).read_whole()


class _Scan:
    """One pass over a log file, which verifies records, keeps intact records and lists problems."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._data = read_file(path)
        self._data_view = memoryview(self._data)
        self._deadline_s = time.thread_time() + seconds_limit()
        self._kept_bytes = 0
        self._problems: list[str] = []
        self._is_sealed = False  # the data section has a checksum
        self._library = ""
        self._is_foreign = False  # another program wrote it, perhaps without index and checksums
        self._has_loose_messages = False
        self._record_by_offset: dict[
            int, list[RawMessage] | Attachment
        ] = {}  # chunks and attachments
        self._channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}

    def read_whole(self) -> RawLog:
        """Read the file record by record, and return what could be read, sorted.

        If the file is damaged, it is also searched for records.

        Raises:
            LogError: If the file is not an MCAP file.
        """
        has_magic = self._data.startswith(MAGIC)
        if not has_magic:
            self._problems.append("the file does not begin as an MCAP file")
        for opcode, begin_offset, end_offset in self._read_records():
            problem = self._verify(opcode, begin_offset, end_offset)
            if problem and len(self._problems) < PROBLEMS_MAX:
                offset = begin_offset - _RECORD.size
                self._problems.append(f"the record at byte {offset} is damaged: {problem}")
        expected_count = self._read_index()
        if self._problems:
            self._search_file()
        if not (has_magic or self._record_by_offset):
            raise LogError(f"{self._path}: this is not an MCAP file")
        log = self._collect()
        if expected_count is None and self._problems:
            log.lost.append("the messages of every missing or damaged chunk")
        elif expected_count is not None and expected_count != len(log.entries):
            log.lost.append(f"{expected_count - len(log.entries)} of {expected_count} messages")
        return log

    def read_summary(self) -> RawLog | None:
        """Read only the records that `peek` returns.

        The result is None for a damaged file, or for a file of another program.
        """
        records_to_keep: set[tuple[int, int, int]] = set()
        last_chunk: tuple[int, int, int] | None = None
        for record in self._read_records():
            opcode, begin_offset, end_offset = record
            if opcode == Opcode.CHUNK:
                last_chunk = record
            elif opcode == Opcode.MESSAGE_INDEX and last_chunk is not None:
                channel = self._data[begin_offset:end_offset][:2]  # its first field
                if int.from_bytes(channel, "little") in _SUMMARY_NUMBERS:
                    records_to_keep.add(last_chunk)
            elif opcode == Opcode.ATTACHMENT:
                records_to_keep.add(record)
            elif opcode == Opcode.MESSAGE:  # outside a chunk
                return None
        self._read_index()
        if self._problems or not self._is_sealed:
            return None
        if any(self._verify(*record) for record in sorted(records_to_keep)):
            return None
        return self._collect()

    def _read_records(self) -> Iterator[tuple[int, int, int]]:
        """Yield the opcode of each record of the data section, and where it begins and ends."""
        record_offset = len(MAGIC)
        for opcode, begin_offset, end_offset in records(self._data, record_offset):
            self._require_time()
            if opcode == Opcode.DATA_END:
                if end_offset - begin_offset != _CHECKSUM.size:
                    self._problems.append("the end of the data section has a wrong length")
                    return
                (stated_checksum,) = _CHECKSUM.unpack_from(self._data, begin_offset)
                self._is_sealed = stated_checksum != UNSTATED
                if self._is_sealed and stated_checksum != zlib.crc32(
                    self._data_view[: begin_offset - _RECORD.size]
                ):
                    self._problems.append("the checksum of the data section does not match")
                return
            yield opcode, begin_offset, end_offset
            record_offset = end_offset
        self._problems.append(f"the file breaks off in the record at byte {record_offset}")

    def _read_index(self) -> int | None:
        """Read the number of messages from the index at the end of the file.

        If the file is damaged, the channels in the index are read, too, because the chunk with the
        record of a channel may be lost.

        Returns:
            The number. None if the index is damaged or missing.
        """
        footer_offset = len(self._data) - len(MAGIC) - _FOOTER.size
        footer_head = self._data[max(0, footer_offset - _RECORD.size) : max(0, footer_offset)]
        if footer_head != _FOOTER_HEAD or not self._data.endswith(MAGIC):
            self._problems.append("the file breaks off before the index at its end")
            return None
        index_offset, _, _ = _FOOTER.unpack_from(self._data, footer_offset)
        if index_offset == 0 and self._is_foreign:
            return None
        if index_offset > footer_offset or not self._has_valid_checksum(
            index_offset, footer_offset + _FOOTER.size - _CHECKSUM.size
        ):
            self._problems.append("the index at the end of the file is damaged")
            return None
        expected_count = None
        for opcode, begin_offset, end_offset in records(self._data, index_offset):
            self._require_time()
            contents = self._data[begin_offset:end_offset]
            with suppress(Exception):  # errors of UTF-8 and MCAP
                if opcode == Opcode.STATISTICS:
                    expected_count = Statistics.read(
                        ReadDataStream(BytesIO(contents))
                    ).message_count
                elif self._problems:
                    self._keep_description(opcode, contents)
        return expected_count

    def _search_file(self) -> None:
        """Search all bytes of the file for chunks and attachments that were not found yet.

        Most bytes that look like the beginning of a chunk or an attachment are something else.
        """
        searches = (
            (Opcode.CHUNK, _ZSTD, -_CHUNK_TIMES_AND_SIZE.size),
            (Opcode.ATTACHMENT, _SMALL_ATTACHMENT, _RECORD.size),
        )
        for opcode, pattern, contents_shift in searches:
            for match in pattern.finditer(self._data):
                self._require_time()
                begin_offset = match.start() + contents_shift
                if begin_offset > 0 and begin_offset not in self._record_by_offset:
                    self._verify(opcode, begin_offset)

    def _verify(self, opcode: int, begin_offset: int, end_offset: int | None = None) -> str:
        """Decode and keep a record.

        Args:
            opcode: Opcode of the record.
            begin_offset: Offset in the file at which the record's contents begin [bytes].
            end_offset: Offset at which the contents end [bytes]. By default, the end of a chunk or
                an attachment is computed from the lengths of its parts.

        Returns:
            The reason why the record cannot be decoded, or "" if the record was kept.
        """
        try:
            if end_offset is None:
                end_offset = self._find_end(opcode, begin_offset)
            self._keep_record(opcode, begin_offset, self._data[begin_offset:end_offset])
        except LogError:
            raise
        except Exception as error:  # errors of zstd, UTF-8, struct and MCAP
            message = str(error)
            return message.splitlines()[0] if message else type(error).__name__
        return ""

    def _find_end(self, opcode: int, begin_offset: int) -> int:
        """Compute the offset at which a compressed chunk or an attachment ends in the file."""
        if opcode == Opcode.CHUNK:
            *_, packed_size = _CHUNK.unpack_from(self._data, begin_offset)
            return begin_offset + _CHUNK.size + packed_size
        end_offset = begin_offset + _TIMES.size
        for length_field in (
            _LENGTH,
            _LENGTH,
            _LONG_LENGTH,
        ):  # of the name, the media type and the data
            (length,) = length_field.unpack_from(self._data, end_offset)
            end_offset += length_field.size + length
        return end_offset + _CHECKSUM.size

    def _keep_record(self, opcode: int, begin_offset: int, contents: bytes) -> None:
        stream = ReadDataStream(BytesIO(contents))
        if opcode == Opcode.CHUNK:
            chunk_data = unpack(Chunk.read(stream), self._is_foreign)
            self._record_by_offset[begin_offset] = self._unpack_messages(chunk_data)
        elif opcode == Opcode.ATTACHMENT:
            attachment = Attachment.read(stream)
            if not self._has_valid_checksum(
                begin_offset, begin_offset + stream.count - _CHECKSUM.size
            ):
                raise ValueError("the attachment's checksum does not match")
            self._count_kept_bytes(stream.count)
            self._record_by_offset[begin_offset] = attachment
        elif opcode == Opcode.HEADER:
            self._library = printable(Header.read(stream).library, 200)
            self._is_foreign = not self._library.startswith(WRITER)
        elif opcode == Opcode.MESSAGE:
            self._has_loose_messages = True

    def _unpack_messages(self, data: bytes) -> list[RawMessage]:
        """Return the messages in an unpacked chunk, and keep its schemas and channels.

        MCAP's `breakup_chunk` would take more than twice the time for each message.
        """
        messages: list[RawMessage] = []
        record_count = 0
        end_offset = 0
        for opcode, begin_offset, end_offset in records(data):
            record_count += 1
            if opcode == Opcode.MESSAGE:
                channel, _, log_ns, publish_ns = _MESSAGE.unpack_from(data, begin_offset)
                message = data[begin_offset + _MESSAGE.size : end_offset]
                messages.append((channel, log_ns, publish_ns, message))
            else:
                self._keep_description(opcode, data[begin_offset:end_offset])
        if end_offset < len(data):
            raise ValueError("the chunk contains an invalid record")
        self._count_kept_bytes(len(data) + 256 * record_count)  # even an empty message takes memory
        return messages

    def _keep_description(self, opcode: int, contents: bytes) -> None:
        """Keep the description of a channel or a schema, which later messages need."""
        if opcode == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(BytesIO(contents)))
            self._channels[channel.id] = channel
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(BytesIO(contents)))
            self._schemas[schema.id] = schema

    def _collect(self) -> RawLog:
        """Return the records found, in file order.

        The topic of each channel comes from the channel's record. If that record is lost, the topic
        follows from the channel's number in the format, unless a remaining record contradicts it.
        """
        topics = {number: channel.topic for number, channel in self._channels.items()}
        if all(_TOPIC_BY_NUMBER.get(number, topic) == topic for number, topic in topics.items()):
            topics = _TOPIC_BY_NUMBER | topics
        in_order: list[Record] = []
        chunks = 0
        for _, record in sorted(self._record_by_offset.items(), key=lambda item: item[0]):
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
                channel.topic: (channel, self._schemas.get(channel.schema_id))
                for channel in self._channels.values()
            },
            library=self._library,
            has_loose_messages=self._has_loose_messages,
        )

    def _has_valid_checksum(self, begin_offset: int, end_offset: int) -> bool:
        """Check whether the checksum at `end_offset` matches the bytes from `begin_offset` to it.

        A file of another program may leave out its checksums.
        """
        (stated_checksum,) = _CHECKSUM.unpack_from(self._data, end_offset)
        is_left_out = self._is_foreign and stated_checksum == UNSTATED
        return is_left_out or stated_checksum == zlib.crc32(
            self._data_view[begin_offset:end_offset]
        )

    def _require_time(self) -> None:
        if time.thread_time() > self._deadline_s:
            raise limit_error(self._path, "very many records, or very many damaged ones")

    def _count_kept_bytes(self, size: int) -> None:
        self._kept_bytes += size
        if self._kept_bytes > file_limit():
            raise limit_error(self._path, "very many bytes or messages in its chunks")


def unpack(chunk: Chunk, may_lack_checksum: bool = False) -> bytes:
    """Decompress a chunk of a log, and check its checksum.

    Args:
        chunk: The compressed chunk.
        may_lack_checksum: Whether to accept a chunk that has no checksum.

    Raises:
        ValueError: If the chunk is too large, its compression is unknown, its size or checksum does
            not match, or it has no checksum and `may_lack_checksum` is False. If the compressed
            data are damaged, zstd or lz4 raise their own errors.
    """
    data = chunk.data
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":  # zstd ignores a limit if the frame states its size
        size = max(size, zstandard.frame_content_size(data))
    if size > CHUNK_MAX:
        raise ValueError(
            f"the chunk states an unpacked size of {size} bytes, but the limit is {CHUNK_MAX} bytes"
        )
    if chunk.compression == "zstd":
        data = zstandard.decompress(data, max_output_size=max(size, 1))
    elif chunk.compression == "lz4":  # by other writers
        data = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    elif chunk.compression:
        raise ValueError(f"the chunk's compression {chunk.compression[:20]!r} is not known")
    stated_checksum = chunk.uncompressed_crc
    is_intact = zlib.crc32(data) == stated_checksum or (
        may_lack_checksum and stated_checksum == UNSTATED
    )
    if len(data) != chunk.uncompressed_size or not is_intact:
        raise ValueError("the chunk's checksum does not match")
    return data
