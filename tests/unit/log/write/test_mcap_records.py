"""Tests of the channels in the file of a log and of their numbers."""

from io import BytesIO

from mcap.reader import make_reader
from mcap.records import Channel
from mcap.writer import Writer
from testkit.random_trials import trial, write

from tetractl.log.format.channels import DIGESTS, LOG, NUMBERS, RESULT, RUN, Entry
from tetractl.log.read.salvage import scan
from tetractl.log.write.mcap_records import FileWriter


def test_a_viewer_lists_no_channel_without_messages(tmp_path):
    """Regression: it listed /unused/11."""
    with write(trial(steps=1), tmp_path / "trial.mcap").open("rb") as file:
        listed = make_reader(file).get_summary()
    counts = listed.statistics.channel_message_counts
    assert {number for number, count in counts.items() if count} == listed.channels.keys()
    assert {RUN, RESULT, DIGESTS} < {channel.topic for channel in listed.channels.values()}
    for channel in listed.channels.values():
        assert channel.id == NUMBERS[channel.topic]


def test_a_channel_of_another_log_gets_a_number_that_is_free():
    stream = BytesIO()
    own = Channel(id=9, topic="/camera/own", message_encoding="json", metadata={}, schema_id=0)
    writer = FileWriter(stream, {"/camera/own": (own, None)})
    for topic in (LOG, "/camera/own", RUN):
        writer.add(Entry(topic, 0, 0, b""))
    writer.finish()
    stream.seek(0)
    listed = make_reader(stream).get_summary().channels
    assert {channel.topic: number for number, channel in listed.items()} == {
        LOG: NUMBERS[LOG],
        "/camera/own": max(NUMBERS.values()) + 1,
        RUN: NUMBERS[RUN],
    }


def without_second_chunk(path, writer, stream, add):
    """Write three chunks, one with /run and two with /log, damage the second, and return how many
    messages of each topic are read.
    """
    ends = []
    for topic in (RUN, LOG, LOG):
        add(topic)
        writer.flush()
        ends.append(stream.tell())
    data = bytearray(stream.getvalue())
    data[(ends[0] + ends[1]) // 2] ^= 0xFF
    path.write_bytes(data)
    return {
        topic: len(entries) for topic, entries in scan(path).entries_by_topic.items() if entries
    }


def test_the_numbers_of_another_writer_are_not_taken_for_those_of_the_format(tmp_path):
    """Its second channel, whose record is lost, is not /host/machine, the second of ours."""
    stream = BytesIO()
    writer = Writer(stream)
    writer.start()
    numbers = {}

    def add(topic):
        if topic not in numbers:
            numbers[topic] = writer.register_channel(topic, "protobuf", 0)
        writer.add_message(numbers[topic], 0, b"", 0)

    writer.register_channel("/other", "protobuf", 0)
    counts = without_second_chunk(tmp_path / "log.mcap", writer, stream, add)
    assert counts == {RUN: 1}


def test_messages_of_a_channel_whose_record_is_lost_are_read_by_their_number(tmp_path):
    stream = BytesIO()
    writer = FileWriter(stream)

    def add(topic):
        writer.add(Entry(topic, 0, 0, b""))

    counts = without_second_chunk(tmp_path / "log.mcap", writer, stream, add)
    assert counts == {RUN: 1, LOG: 1}
