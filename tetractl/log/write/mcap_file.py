"""An MCAP file while it is written, to the specification at https://mcap.dev/spec.

The file is, byte for byte, that of `mcap.writer.Writer` with chunks, zstd, every index and every
checksum. That writer takes each message through some twenty calls; here a message is one pack into
the chunk, and the index of a channel another.
"""

import struct
import zlib
from collections import defaultdict
from collections.abc import Mapping
from typing import BinaryIO

import zstandard
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
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

CHUNK_SIZE = 1024 * 1024  # bytes from which on a chunk is ended
_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, both times
_MESSAGE_FIXED = 22  # bytes of a message that count in its length, without the data


class McapFile:
    """Writes to an empty `file`, from the header on; `finish` writes the index, and closes nothing.

    Messages, schemas and channels wait in a chunk for `flush`. Metadata and attachments go to the
    file at once, before the messages that wait.
    """

    def __init__(self, file: BinaryIO, library: str) -> None:
        self._file = file
        self._size = 0  # bytes written
        self._crc = 0
        self._zstd = zstandard.ZstdCompressor()
        self._chunk = bytearray()
        self._index: dict[int, list[int]] = {}  # by channel: time, offset, time, offset, ...
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._counts: defaultdict[int, int] = defaultdict(int)  # of messages, by channel
        self._put(MCAP0_MAGIC)
        self._put(_encoded(Header("", library)))

    def schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add a schema, and return its id."""
        made = Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data)
        self._schemas.append(made)
        self._chunk += _encoded(made)
        return made.id

    def channel(
        self, topic: str, message_encoding: str, schema: int, metadata: Mapping[str, str]
    ) -> int:
        """Add a channel, and return its id."""
        made = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding=message_encoding,
            metadata=dict(metadata),
            schema_id=schema,
        )
        self._channels.append(made)
        self._chunk += _encoded(made)
        return made.id

    def message(self, channel: int, log_ns: int, publish_ns: int, data: bytes) -> None:
        """Add a message with the times at which it was received and sampled [Unix ns]."""
        chunk, index = self._chunk, self._index.get(channel)
        if index is None:
            index = self._index[channel] = []
        index += (log_ns, len(chunk))
        length = _MESSAGE_FIXED + len(data)
        chunk += _MESSAGE.pack(Opcode.MESSAGE, length, channel, 0, log_ns, publish_ns)
        chunk += data
        if len(chunk) > CHUNK_SIZE:
            self._end_chunk()

    def metadata(self, name: str, items: Mapping[str, str]) -> None:
        """Add a metadata record."""
        data = _encoded(Metadata(name=name, metadata=dict(items)))
        self._metadata.append(MetadataIndex(offset=self._size, length=len(data), name=name))
        self._put(data)

    def attachment(self, name: str, media_type: str, unix_ns: int, data: bytes) -> None:
        """Add an attachment."""
        made = Attachment(
            create_time=0, log_time=unix_ns, name=name, media_type=media_type, data=data
        )
        encoded = _encoded(made)
        self._attachments.append(
            AttachmentIndex(
                offset=self._size,
                length=len(encoded),
                create_time=0,
                log_time=unix_ns,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )
        self._put(encoded)

    def flush(self) -> None:
        """End the chunk, if it has a message, and hand all to the operating system."""
        self._end_chunk()
        self._file.flush()

    def finish(self) -> None:
        """End the chunk, and write the summary and what ends a file."""
        self._end_chunk()
        self._put(_encoded(DataEnd(self._crc)))
        start, summary = self._size, RecordBuilder()
        groups = (
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, self._attachments),
            (Opcode.METADATA_INDEX, self._metadata),
        )
        offsets: list[SummaryOffset] = []
        for opcode, records in groups:
            begin = summary.count
            for record in records:
                record.write(summary)
            length = summary.count - begin
            offsets.append(
                SummaryOffset(group_opcode=opcode, group_start=start + begin, group_length=length)
            )
        offset_start = start + summary.count
        for offset in offsets:
            offset.write(summary)
        data = summary.end()
        # The checksum of the summary covers the footer up to itself.
        footer = struct.pack("<BQQQ", Opcode.FOOTER, 8 + 8 + 4, start, offset_start)
        crc = zlib.crc32(footer, zlib.crc32(data))
        self._put(data)
        self._put(_encoded(Footer(start, offset_start, crc)))
        self._put(MCAP0_MAGIC)
        self._file.flush()

    def _put(self, data: bytes) -> None:
        self._crc = zlib.crc32(data, self._crc)
        self._file.write(data)
        self._size += len(data)

    def _end_chunk(self) -> None:
        """Write the chunk and the index of each of its channels."""
        if not self._index:
            return
        times = [time for index in self._index.values() for time in index[::2]]
        data = bytes(self._chunk)
        chunk = Chunk(
            compression="zstd",
            data=self._zstd.compress(data),
            message_start_time=min(times),
            message_end_time=max(times),
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        )
        begin = self._size
        self._put(_encoded(chunk))
        end = self._size
        offsets: dict[int, int] = {}
        for channel, index in self._index.items():
            offsets[channel] = self._size
            self._counts[channel] += len(index) // 2
            size = 8 * len(index)
            layout = f"<BQHI{len(index)}Q"
            self._put(struct.pack(layout, Opcode.MESSAGE_INDEX, 6 + size, channel, size, *index))
        self._chunks.append(
            ChunkIndex(
                message_start_time=chunk.message_start_time,
                message_end_time=chunk.message_end_time,
                chunk_start_offset=begin,
                chunk_length=end - begin,
                message_index_offsets=offsets,
                message_index_length=self._size - end,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                uncompressed_size=chunk.uncompressed_size,
            )
        )
        self._chunk = bytearray()
        self._index = {}

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            message_end_time=max((chunk.message_end_time for chunk in self._chunks), default=0),
            message_start_time=min((c.message_start_time for c in self._chunks), default=0),
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )


def _encoded(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()
