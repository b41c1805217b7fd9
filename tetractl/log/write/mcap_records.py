"""Writes and hashes the records of a log's MCAP file, with its channels under the numbers of the
format.
"""

from dataclasses import replace
from functools import cache
from typing import Any, BinaryIO

from google.protobuf.message import Message
from mcap.records import Attachment, Channel, Schema, Statistics
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer
from mcap_protobuf.schema import build_file_descriptor_set

from tetractl.core import __version__
from tetractl.log.format.channels import CHANNELS, METADATA, NUMBERS, WRITER, Record
from tetractl.log.format.digest import LogDigests

UNNUMBERED = 0
"""MCAP's number of no schema."""


class NumberedWriter(Writer):
    """A writer of MCAP whose channels have numbers of their own.

    `mcap.Writer` has no public way to that: `register_channel` counts them. What it does is done
    here with its private fields, and nothing else of the package needs them.
    """

    _Writer__channels: dict[int, Channel]
    _Writer__chunk_builder: Any
    _Writer__statistics: Statistics

    def record_channel(self, channel: Channel) -> None:
        """Record a channel under its number, which no other one has."""
        self._Writer__channels[channel.id] = channel
        self._Writer__statistics.channel_count += 1
        self._Writer__chunk_builder.add_channel(channel)


class FileWriter(NumberedWriter):
    """The file of a log, begun with its metadata; it hashes the records that it writes.

    A channel and its schema are recorded before the channel's first message, so that viewers list
    no channel without messages. Each topic of the format has its number, whichever others are in
    the file.
    """

    def __init__(self, stream: BinaryIO) -> None:
        super().__init__(stream, use_summary_offsets=False, enable_data_crcs=True)
        self.digests = LogDigests()
        self._numbers = dict[str, int]()  # of the channels so far, by topic
        self._schemas = dict[tuple[str, bytes], int]()  # by name and data
        self._others = dict[str, tuple[Channel, Schema | None]]()  # channels of another log
        self.start(library=f"{WRITER} {__version__}")
        # for other readers: some report a file without metadata as damaged
        self.add_metadata(*METADATA)

    def allow(self, channel: Channel, schema: Schema | None) -> None:
        """Take messages of another log's channel; a topic of the format keeps its own."""
        if channel.topic not in NUMBERS:
            self._others.setdefault(channel.topic, (channel, schema))

    def add(self, record: Record) -> None:
        """Add a message, after the record of its channel if it is the first, or an attachment,
        after the chunk of the messages so far."""
        self.digests.add(record)
        if isinstance(record, Attachment):
            self.flush()
            self.add_attachment(0, record.log_time, record.name, record.media_type, record.data)
            return
        number = self._numbers.get(record.topic)
        if number is None:
            channel = self._channel(record.topic)
            self.record_channel(channel)
            number = self._numbers[record.topic] = channel.id
        self.add_message(number, record.log_ns, record.data, record.publish_ns)

    def _channel(self, topic: str) -> Channel:
        """Return the channel of a topic, whose schema is recorded."""
        if topic in NUMBERS:
            return Channel(
                id=NUMBERS[topic],
                topic=topic,
                message_encoding=MessageEncoding.Protobuf,
                metadata={},
                schema_id=self._record_schema(protobuf_schema(CHANNELS[topic])),
            )
        of_other_log, schema = self._others[topic]
        schema_id = UNNUMBERED if schema is None else self._record_schema(schema)
        number = max(*NUMBERS.values(), *self._numbers.values()) + 1
        return replace(of_other_log, id=number, schema_id=schema_id)

    def _record_schema(self, schema: Schema) -> int:
        """Record a schema, unless the same one is recorded, and return its number."""
        key = schema.name, schema.data
        if key not in self._schemas:
            self._schemas[key] = self.register_schema(schema.name, schema.encoding, schema.data)
        return self._schemas[key]


@cache
def protobuf_schema(message: type[Message]) -> Schema:
    """Return the schema of a message, without a number of its own."""
    descriptor = message.DESCRIPTOR
    files = build_file_descriptor_set(message)
    used = _used(descriptor)
    for file in files.file:
        if file.name == descriptor.file.name:  # tetractl's own has the messages of all channels
            used_types = [kind for kind in file.message_type if kind.name in used]
            del file.message_type[:]
            file.message_type.extend(used_types)
    return Schema(
        id=UNNUMBERED,
        name=descriptor.full_name,
        encoding=SchemaEncoding.Protobuf,
        data=files.SerializeToString(),
    )


def _used(descriptor: Any) -> set[str]:
    """Return the names of a message and of all messages inside it."""
    names = {descriptor.name}
    for field in descriptor.fields:
        if field.message_type:
            names |= _used(field.message_type)
    return names
