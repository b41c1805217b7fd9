"""Creates logs with one changed number and matching checksums and digest."""

import math
import struct
import zlib
from collections.abc import Iterator, Mapping, MutableSequence
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from google.protobuf.message import Message
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Attachment
from mcap.writer import Writer

from tetractl.log.format.channels import CHANNELS, DIGESTS, HOST, Entry
from tetractl.log.format.tetractl_pb2 import Host
from tetractl.log.read.raw_log import RawLog
from tetractl.log.write.sink import Sink

Place = tuple[str | int, ...]

CHANGE = 0.0  # relative, of a float; 0 for the least there is


def places(message: Message, inside: Place = ()) -> Iterator[Place]:
    """Yield where each number, truth value and word of a message is."""
    for field, value in message.ListFields():
        place = (*inside, field.name)
        if isinstance(value, MutableSequence):
            for index, item in enumerate(value):
                yield from _places_of(item, (*place, index))
        else:
            yield from _places_of(value, place)


def _places_of(value: Any, place: Place) -> Iterator[Place]:
    if isinstance(value, Message):
        yield from places(value, place)
    else:
        yield place


def holder_of(message: Message, place: Place) -> tuple[Any, str | int]:
    """Return what holds the value at a place, and the field or index under which it does."""
    *way, last = place
    return reduce(_step, way, message), last


def changed(message: Message, place: Place) -> Message:
    """Return a message with one number changed by as little as can be."""
    copy = type(message)()
    copy.CopyFrom(message)
    holder, last = holder_of(copy, place)
    for least in (other, _single):  # of a number of single precision, the first changes nothing
        if copy == message:
            if isinstance(last, int):
                holder[last] = least(holder[last])
            else:
                setattr(holder, last, least(getattr(holder, last)))
    return copy


def _single(value: float) -> float:
    single = np.float32(value)
    return float(np.nextafter(single, np.float32(np.inf)))


def other(value: Any) -> Any:
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + 1 if value < 2**63 - 1 else value - 1
    if isinstance(value, bytes):
        offset = zlib.crc32(value) % len(value)  # another one in each
        return value[:offset] + bytes([value[offset] ^ 1]) + value[offset + 1 :]
    if isinstance(value, float):
        if math.isnan(value):  # every change of it is itself
            return 0.0
        if CHANGE:
            return value + CHANGE * (abs(value) or 1)
        # the number next to 0 vanishes in every sum
        return math.nextafter(value, math.inf) if value else math.ulp(1.0)
    return "criterion" if value != "criterion" else "iterations"


def with_entry(contents: RawLog, path: Path, index: int, place: Place) -> Path:
    """Write a log in which one number of message `index` is changed."""
    entry = contents.entries[index]
    message = changed(CHANNELS[entry.topic].FromString(entry.data), place)
    return rewrite(contents, path, {entry: entry._replace(data=message.SerializeToString())})


def stating(contents: RawLog, topic: str, **fields: Any) -> dict[Entry, Entry]:
    """The first message of a topic with some fields replaced, to be given to `rewrite`."""
    entry = contents.entries_by_topic[topic][0]
    message: Any = CHANNELS[topic].FromString(entry.data)
    for name, value in fields.items():
        if isinstance(value, list):
            del getattr(message, name)[:]
            getattr(message, name).extend(value)
        else:
            setattr(message, name, value)
    return {entry: entry._replace(data=message.SerializeToString())}


def of_host(contents: RawLog, **facts: str) -> dict[Entry, Entry]:
    """The message of the host with some facts replaced, to be given to `rewrite`."""
    entry = contents.entries_by_topic[HOST][0]
    message = Host.FromString(entry.data)
    for fact in message.facts:
        fact.value = facts.get(fact.key, fact.value)
    return {entry: entry._replace(data=message.SerializeToString())}


def rewrite(
    contents: RawLog, path: Path, entries: Mapping[Entry, Entry], apart: bool = False
) -> Path:
    """Write a log again with some entries replaced, or each message in its own chunk."""
    sink = Sink(path, other_channels=contents.channels)
    for record in contents.records:
        if isinstance(record, Attachment):
            sink.add(record)
        elif record.topic == DIGESTS:
            sink.seal(record.log_ns)
        else:
            sink.add(entries.get(record, record))
            if apart:
                sink.flush()
    sink.close(complete=True)
    return path


def rewritten(
    log: Path, path: Path, in_order: bool = False, keeps_name: bool = False, **options: Any
) -> Path:
    """Write a log again as a program does that has MCAP's library and not tetractl; the messages
    are in the order of their times, which is the reader's default, or else `in_order`. One that
    `keeps_name` copies the header, and writes attachments first."""
    with log.open("rb") as source, path.open("wb") as file:
        reader = make_reader(source)
        writer = Writer(file, **options)
        header = reader.get_header()
        if keeps_name:
            writer.start(header.profile, header.library)
        else:
            writer.start()
        attachments = list(reader.iter_attachments())
        for item in attachments if keeps_name else ():
            writer.add_attachment(0, item.log_time, item.name, item.media_type, item.data)
        for item in reader.iter_metadata():
            writer.add_metadata(item.name, item.metadata)
        numbers: dict[int, int] = {}
        for schema, channel, message in reader.iter_messages(log_time_order=not in_order):
            if channel.id not in numbers:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                encoding = channel.message_encoding
                number = writer.register_channel(channel.topic, encoding, schema_id)
                numbers[channel.id] = number
            number = numbers[channel.id]
            writer.add_message(number, message.log_time, message.data, message.publish_time)
        for item in () if keeps_name else attachments:
            writer.add_attachment(0, item.log_time, item.name, item.media_type, item.data)
        writer.finish()
    return path


def chunk(data, size=None, raw=None):
    """A chunk record that unpacks to `data`, or says it unpacks to `size`."""
    packed = zstandard.compress(data) if raw is None else raw
    said = len(data) if size is None else size
    head = struct.pack("<QQQI", 0, 0, said, zlib.crc32(data)) + b"\x04\0\0\0zstd"
    body = head + struct.pack("<Q", len(packed)) + packed
    return bytes([Opcode.CHUNK]) + struct.pack("<Q", len(body)) + body


def _step(holder: Any, part: str | int) -> Any:
    return holder[part] if isinstance(part, int) else getattr(holder, part)
