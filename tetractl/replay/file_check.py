"""Checks a log's file beyond its messages and attachments: it must be the file that the log writer
makes of them.
"""

from collections.abc import Iterator
from io import BytesIO
from itertools import zip_longest

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Message
from mcap.stream_reader import MAGIC_SIZE, StreamReader, breakup_chunk

from tetractl.log.format.channels import CAMERA, CHANNELS, METADATA
from tetractl.log.read.raw_log import RawLog, read_file
from tetractl.log.write.sink import new_writer

HEAD = 9  # opcode and length, before the contents of every record


def file_differences(raw: RawLog, exactly: bool) -> Iterator[str]:
    """Yield what in the file of an undamaged log is not as tetractl writes it.

    With `exactly`, the file is written again, chunk by chunk, and compared record by record. Other
    versions of the libraries, and other programs, divide and compress chunks in their own way: of
    their files, only metadata, channels and kinds of records are reported that no log has.
    """
    for number, item in enumerate(raw.metadata):
        if number or (item.name, item.metadata) != METADATA:
            yield f"has the metadata {item.name[:60]!r}, which are not of tetractl"
    for topic in raw.channels.keys() - CHANNELS.keys():
        if not topic.startswith(CAMERA):
            yield f"has the channel {topic[:60]!r}, which is not of tetractl"
    for opcode in sorted(raw.strange):
        yield f"has a record of type {opcode}, which is not of tetractl"
    if raw.rewritten or not exactly:
        return
    data = read_file(raw.path)
    try:
        again = _written_again(data)
    except Exception as error:  # errors of MCAP's reader, UTF-8 and struct
        yield f"cannot be read by MCAP's reader: {error}"
        return
    if again == data:
        return
    for logged, made in zip_longest(_records(data), _records(again), fillvalue=(0, 0, b"")):
        if logged != made:
            yield f"{_named(*logged)} is not as tetractl writes it"
            return


def _written_again(data: bytes) -> bytes:
    """Return the file that the log writer makes of the messages and attachments in a file."""
    stream, topics = BytesIO(), dict[int, str]()
    writer, channels = new_writer(stream)
    for record in StreamReader(BytesIO(data), emit_chunks=True).records:
        if isinstance(record, Attachment):
            writer.add_attachment(0, record.log_time, record.name, record.media_type, record.data)
        elif isinstance(record, Chunk):
            for item in breakup_chunk(record):
                if isinstance(item, Channel):
                    topics[item.id] = item.topic
                elif isinstance(item, Message) and (topic := topics[item.channel_id]) in channels:
                    writer.add_message(channels[topic], item.log_time, item.data, item.publish_time)
            writer.flush()
    writer.finish()
    return stream.getvalue()


def _records(data: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Yield offset, opcode and contents of each record in a file."""
    begin = MAGIC_SIZE
    while begin < len(data) - MAGIC_SIZE:
        behind = begin + HEAD + int.from_bytes(data[begin + 1 : begin + HEAD], "little")
        yield begin, data[begin], data[begin + HEAD : behind]
        begin = behind


def _named(offset: int, opcode: int, _: bytes) -> str:
    """Return a record's kind and place, such as "the chunk index at byte 27"."""
    known = {int(one): one.name.lower().replace("_", " ") for one in Opcode}
    return f"the {known.get(opcode, f'record of type {opcode}')} at byte {offset}"
