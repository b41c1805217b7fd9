"""Write the MCAP file (mcap.dev/spec) of a log, with fixed channel numbers.

    magic, header, metadata
    chunks: messages, compressed, and behind them an index for each channel
    attachments, between chunks
    end of the data, then the summary: schemas, channels, statistics, indexes
    footer, magic

A channel and its schema are recorded before the channel's first message, so that viewers list no
channel without messages.
"""

import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cache
from typing import Any, BinaryIO

import zstandard
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import Message as ProtobufMessage
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
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.well_known import MessageEncoding, SchemaEncoding

from tetractl.core import __version__
from tetractl.log.format.channels import (
    CHANNELS,
    MAGIC,
    METADATA,
    NUMBERS,
    WRITER,
    Entry,
    Record,
)
from tetractl.log.format.digest import LogDigests

UNNUMBERED = 0
"""Number that MCAP uses for "no schema"."""
CHUNK_BYTES = 1 << 20
"""Size of a chunk's messages above which the chunk ends [bytes]."""
FOOTER_FIELDS = struct.Struct("<BQQQ")
"""Layout of the part of the footer that its checksum covers: opcode, length, two offsets."""
FOOTER_BYTES = 20
"""Length of the contents of the footer record [bytes]."""
OtherChannels = Mapping[str, tuple[Channel, Schema | None]]
"""Channels of another log, each with its schema, by topic. The schema may be None."""
NO_OTHER_CHANNELS: OtherChannels = {}


class FileWriter:
    """A writer for the MCAP file of a log, which also hashes the records that it writes.

    The file begins with its metadata. Each topic of the format has a fixed channel number, which
    does not depend on the other topics in the file. `mcap.writer.Writer` does not allow that.

    Args:
        stream: The open file.
        other_channels: Channels of a log that is copied, by topic. Channels of cameras are copied
            unchanged.
    """

    def __init__(self, stream: BinaryIO, other_channels: OtherChannels = NO_OTHER_CHANNELS) -> None:
        self.digests = LogDigests()
        self._stream = stream
        self._written_bytes = 0  # bytes written so far
        self._crc = 0  # checksum of the bytes written so far
        self._other_channels = other_channels
        # what is recorded so far: channels by topic, schemas by name and data
        self._channels = dict[str, Channel]()
        self._schemas = dict[tuple[str, bytes], Schema]()
        # the open chunk, and the messages in it by the number of their channel
        self._chunk = RecordBuilder()
        self._message_indexes = dict[int, MessageIndex]()
        # what the summary states
        self._chunk_indexes: list[ChunkIndex] = []
        self._attachment_indexes: list[AttachmentIndex] = []
        self._message_counts = Counter[int]()  # messages, by the number of their channel

        self._write(MAGIC)
        self._write_record(Header(profile="", library=f"{WRITER} {__version__}"))
        # for other readers: some report a file without metadata as damaged
        name, contents = METADATA
        metadata_offset = self._written_bytes
        self._write_record(Metadata(name=name, metadata=contents))
        self._metadata_index = MetadataIndex(
            offset=metadata_offset, length=self._written_bytes - metadata_offset, name=name
        )

    def add(self, record: Record) -> None:
        """Add a message or an attachment.

        The first message of a channel follows the channel's record. An attachment follows the chunk
        of the messages so far.
        """
        self.digests.add(record)
        if isinstance(record, Attachment):
            self.flush()
            self._write_attachment(record)
        else:
            self._add_message(record)

    def flush(self) -> None:
        """End the chunk of the messages so far, if there are any, and flush the stream."""
        if self._message_indexes:
            self._write_chunk()
        self._stream.flush()

    def finish(self) -> None:
        """Write the last chunk and the summary. The stream stays open."""
        self.flush()
        self._write_record(DataEnd(data_section_crc=self._crc))
        summary_offset = self._written_bytes
        summary = RecordBuilder()
        for record in self._summary():
            record.write(summary)
        summary_data = summary.end()
        self._write(summary_data)
        fields = FOOTER_FIELDS.pack(Opcode.FOOTER, FOOTER_BYTES, summary_offset, 0)
        crc = zlib.crc32(fields, zlib.crc32(summary_data))
        self._write_record(
            Footer(summary_start=summary_offset, summary_offset_start=0, summary_crc=crc)
        )
        self._write(MAGIC)

    # ---- a record ----

    def _write(self, data: bytes) -> None:
        self._crc = zlib.crc32(data, self._crc)
        self._stream.write(data)
        self._written_bytes += len(data)

    def _write_record(self, record: McapRecord) -> None:
        builder = RecordBuilder()
        record.write(builder)
        self._write(builder.end())

    def _write_attachment(self, attachment: Attachment) -> None:
        begin_offset = self._written_bytes
        written = replace(attachment, create_time=0)
        self._write_record(written)
        self._attachment_indexes.append(
            AttachmentIndex(
                offset=begin_offset,
                length=self._written_bytes - begin_offset,
                log_time=written.log_time,
                create_time=written.create_time,
                data_size=len(written.data),
                name=written.name,
                media_type=written.media_type,
            )
        )

    # ---- the open chunk ----

    def _add_message(self, entry: Entry) -> None:
        """Add a message to the open chunk, and end the chunk if it is large."""
        channel = self._channels.get(entry.topic) or self._record_channel(entry.topic)
        index = self._message_indexes.get(channel.id)
        if index is None:
            index = self._message_indexes[channel.id] = MessageIndex(
                channel_id=channel.id, records=[]
            )
        index.records.append((entry.log_ns, self._chunk.count))
        self._message_counts[channel.id] += 1
        message = Message(
            channel_id=channel.id,
            log_time=entry.log_ns,
            data=entry.data,
            publish_time=entry.publish_ns,
            sequence=0,
        )
        message.write(self._chunk)
        if self._chunk.count > CHUNK_BYTES:
            self._write_chunk()

    def _record_channel(self, topic: str) -> Channel:
        """Record a topic's channel and its schema in the open chunk, and return the channel."""
        if topic in NUMBERS:
            channel = Channel(
                id=NUMBERS[topic],
                topic=topic,
                message_encoding=MessageEncoding.Protobuf,
                metadata={},
                schema_id=self._record_schema(protobuf_schema(CHANNELS[topic])),
            )
        else:
            other_channel, schema = self._other_channels[topic]
            numbers = [channel.id for channel in self._channels.values()]
            channel = replace(
                other_channel,
                id=max(*NUMBERS.values(), *numbers) + 1,
                schema_id=UNNUMBERED if schema is None else self._record_schema(schema),
            )
        channel.write(self._chunk)
        self._channels[topic] = channel
        return channel

    def _record_schema(self, schema: Schema) -> int:
        """Record a schema in the open chunk, if it is new, and return its number."""
        key = schema.name, schema.data
        if key not in self._schemas:
            self._schemas[key] = replace(schema, id=len(self._schemas) + 1)
            self._schemas[key].write(self._chunk)
        return self._schemas[key].id

    def _write_chunk(self) -> None:
        """Write the open chunk and the indexes of its messages, and begin the next chunk."""
        data = self._chunk.end()
        times_ns = [ns for index in self._message_indexes.values() for ns, _ in index.records]
        chunk = Chunk(
            compression="zstd",
            data=zstandard.compress(data),
            message_start_time=min(times_ns),
            message_end_time=max(times_ns),
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        )
        begin_offset = self._written_bytes
        self._write_record(chunk)
        end_offset = self._written_bytes
        index_offsets: dict[int, int] = {}
        for number, index in self._message_indexes.items():
            index_offsets[number] = self._written_bytes
            self._write_record(index)
        self._message_indexes.clear()
        self._chunk_indexes.append(
            ChunkIndex(
                chunk_start_offset=begin_offset,
                chunk_length=end_offset - begin_offset,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                uncompressed_size=chunk.uncompressed_size,
                message_start_time=chunk.message_start_time,
                message_end_time=chunk.message_end_time,
                message_index_offsets=index_offsets,
                message_index_length=self._written_bytes - end_offset,
            )
        )

    # ---- the summary ----

    def _summary(self) -> Iterator[McapRecord]:
        """Yield the records that are repeated at the end of the file, and an index of its parts."""
        statistics = Statistics(
            attachment_count=len(self._attachment_indexes),
            channel_count=len(self._channels),
            channel_message_counts=self._message_counts,
            chunk_count=len(self._chunk_indexes),
            message_count=self._message_counts.total(),
            message_start_time=min(
                (chunk.message_start_time for chunk in self._chunk_indexes), default=0
            ),
            message_end_time=max(
                (chunk.message_end_time for chunk in self._chunk_indexes), default=0
            ),
            metadata_count=1,
            schema_count=len(self._schemas),
        )
        yield from self._schemas.values()
        yield from self._channels.values()
        yield statistics
        yield from self._chunk_indexes
        yield from self._attachment_indexes
        yield self._metadata_index


def _list_with_imports(file: Any) -> list[Any]:
    """List all files that a `FileDescriptor` imports, each once, followed by the file itself."""
    listed: dict[str, Any] = {}
    for imported in file.dependencies:
        listed |= {
            imported_file.name: imported_file for imported_file in _list_with_imports(imported)
        }
    return [*listed.values(), file]


@cache
def protobuf_schema(message: type[ProtobufMessage]) -> Schema:
    """Create the MCAP schema of a protobuf message class. The schema has no number yet."""
    descriptor = message.DESCRIPTOR
    files = FileDescriptorSet()
    for definition in _list_with_imports(descriptor.file):
        definition.CopyToProto(files.file.add())
    used_names = _nested_message_names(descriptor)
    for file in files.file:
        if file.name == descriptor.file.name:  # tetractl's own file has the types of all channels
            used_types = [
                message_type
                for message_type in file.message_type
                if message_type.name in used_names
            ]
            del file.message_type[:]
            file.message_type.extend(used_types)
    return Schema(
        id=UNNUMBERED,
        name=descriptor.full_name,
        encoding=SchemaEncoding.Protobuf,
        data=files.SerializeToString(),
    )


def _nested_message_names(descriptor: Any) -> set[str]:
    """Return the names of a message and of all messages inside it."""
    names = {descriptor.name}
    for field in descriptor.fields:
        if field.message_type:
            names |= _nested_message_names(field.message_type)
    return names
