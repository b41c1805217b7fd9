"""An MCAP file: messages are put into chunks, other records between them, and an index at the end.

The records are those of the library `mcap`. Its own writer takes longer for a message than all that
tetractl does to make one, and compresses at one level.
"""

import struct
import zlib
from collections import defaultdict
from functools import cache
from typing import BinaryIO

import zstandard
from google.protobuf.message import Message
from mcap.data_stream import RecordBuilder
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
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.well_known import SchemaEncoding
from mcap_protobuf.schema import build_file_descriptor_set

MAGIC = b"\x89MCAP0\r\n"
LEVEL = 1
"""Of the compression: most bytes are the digits of measurements, which no level makes fewer."""
CHUNK_MAX = 1 << 20
"""Bytes at which a chunk ends by itself, of the 16 MiB that a reader takes."""

_MESSAGE, _HEAD = struct.Struct("<BQHIQQ"), 9
_ENTRY = struct.Struct("<QQ")
_INDEX = struct.Struct("<BQHI")


class McapFile:
    """Writes MCAP to an open file; `flush` ends a chunk, and `finish` the file.

    Times are Unix ns. Everything between two chunks is covered by the checksum of the data section.
    """

    def __init__(self, file: BinaryIO, library: str) -> None:
        self._file, self._crc, self._at = file, 0, 0
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._counts: dict[int, int] = defaultdict(int)  # messages by channel
        self._start_chunk()
        self._write(MAGIC)
        self._write(_record(Header("", library)))

    def _start_chunk(self) -> None:
        self._chunk = bytearray()
        self._times: dict[int, list[bytes]] = defaultdict(list)  # of a channel: time and offset
        self._first_ns, self._last_ns = 1 << 64, 0

    def schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add a schema; return its id."""
        self._schemas.append(Schema(len(self._schemas) + 1, data, encoding, name))
        self._chunk += _record(self._schemas[-1])
        return len(self._schemas)

    def channel(self, topic: str, encoding: str, schema: int, facts: dict[str, str]) -> int:
        """Add a channel; return its id."""
        self._channels.append(Channel(len(self._channels) + 1, topic, encoding, facts, schema))
        self._chunk += _record(self._channels[-1])
        return len(self._channels)

    def message(self, channel: int, log_ns: int, publish_ns: int, data: bytes) -> None:
        """Add a message to the chunk."""
        self._times[channel].append(_ENTRY.pack(log_ns, len(self._chunk)))
        size = _MESSAGE.size - _HEAD + len(data)
        self._chunk += _MESSAGE.pack(Opcode.MESSAGE, size, channel, 0, log_ns, publish_ns)
        self._chunk += data
        self._first_ns, self._last_ns = min(self._first_ns, log_ns), max(self._last_ns, log_ns)
        if len(self._chunk) > CHUNK_MAX:
            self.flush()

    def metadata(self, name: str, items: dict[str, str]) -> None:
        """Add a metadata record."""
        data = _record(Metadata(name, items))
        self._metadata.append(MetadataIndex(self._at, len(data), name))
        self._write(data)

    def attachment(self, name: str, media_type: str, unix_ns: int, data: bytes) -> None:
        """Add an attachment."""
        record = _record(Attachment(0, unix_ns, name, media_type, data))
        index = AttachmentIndex(self._at, len(record), unix_ns, 0, len(data), name, media_type)
        self._attachments.append(index)
        self._write(record)

    def flush(self) -> None:
        """End the chunk, if it has a message, and hand everything to the operating system."""
        if self._times:
            self._end_chunk()
        self._file.flush()

    def _end_chunk(self) -> None:
        data = zstandard.compress(bytes(self._chunk), LEVEL)
        size, crc = len(self._chunk), zlib.crc32(self._chunk)
        span = self._first_ns, self._last_ns
        record = _record(Chunk("zstd", data, span[1], span[0], crc, size))
        begin, offsets = self._at, dict[int, int]()
        self._write(record)
        for channel, entries in self._times.items():
            offsets[channel] = self._at
            length = 16 * len(entries)
            head = _INDEX.pack(Opcode.MESSAGE_INDEX, length + 6, channel, length)
            self._write(head + b"".join(entries))
            self._counts[channel] += len(entries)
        self._chunks.append(
            ChunkIndex(
                chunk_length=len(record),
                chunk_start_offset=begin,
                compression="zstd",
                compressed_size=len(data),
                message_end_time=span[1],
                message_index_length=self._at - begin - len(record),
                message_index_offsets=offsets,
                message_start_time=span[0],
                uncompressed_size=size,
            )
        )
        self._start_chunk()

    def finish(self) -> None:
        """End the chunk and write the index of the file."""
        self.flush()
        self._write(_record(DataEnd(self._crc)))
        chunks, attachments, metadata = self._chunks, self._attachments, self._metadata
        statistics = Statistics(
            attachment_count=len(attachments),
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=len(chunks),
            message_count=sum(self._counts.values()),
            message_end_time=max((one.message_end_time for one in chunks), default=0),
            message_start_time=min((one.message_start_time for one in chunks), default=0),
            metadata_count=len(metadata),
            schema_count=len(self._schemas),
        )
        begin, self._crc = self._at, 0
        groups = (self._schemas, self._channels, [statistics], chunks, attachments, metadata)
        for records in groups:
            self._write(b"".join(map(_record, records)))
        footer = _record(Footer(begin, 0, 0))[:-4]  # which states the checksum with its head
        self._write(footer)
        self._write(self._crc.to_bytes(4, "little") + MAGIC)

    def _write(self, data: bytes) -> None:
        self._crc = zlib.crc32(data, self._crc)
        self._at += len(data)
        self._file.write(data)


def _record(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


@cache
def protobuf_schema(message: type[Message]) -> tuple[str, str, bytes]:
    """Return name, encoding and data of the schema of a message."""
    data = build_file_descriptor_set(message).SerializeToString()
    return message.DESCRIPTOR.full_name, SchemaEncoding.Protobuf, data
