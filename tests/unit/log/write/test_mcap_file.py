"""The file is that of the official writer, byte for byte, and the official reader reads it."""

from io import BytesIO

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from tetractl.log.write.mcap_file import CHUNK_SIZE, McapFile

LIBRARY = "a test"


class Both:
    """Gives every call to our file and to the official writer."""

    def __init__(self) -> None:
        self.ours, self.theirs = BytesIO(), BytesIO()
        self.file = McapFile(self.ours, LIBRARY)
        self.writer = Writer(self.theirs, compression=CompressionType.ZSTD, enable_data_crcs=True)
        self.writer.start(library=LIBRARY)

    def channel(self, topic: str, schema: bytes | None, metadata: dict[str, str]) -> int:
        known, other = 0, 0
        if schema is not None:
            known = self.file.schema(f"of {topic}", "protobuf", schema)
            other = self.writer.register_schema(f"of {topic}", "protobuf", schema)
        made = self.file.channel(topic, "raw", known, metadata)
        assert (known, made) == (other, self.writer.register_channel(topic, "raw", other, metadata))
        return made

    def message(self, channel: int, log_ns: int, publish_ns: int, data: bytes) -> None:
        self.file.message(channel, log_ns, publish_ns, data)
        self.writer.add_message(channel, log_ns, data, publish_ns)

    def metadata(self, name: str, items: dict[str, str]) -> None:
        self.file.metadata(name, items)
        self.writer.add_metadata(name, items)

    def attachment(self, name: str, unix_ns: int, data: bytes) -> None:
        self.file.attachment(name, "text/plain", unix_ns, data)
        self.writer.add_attachment(0, unix_ns, name, "text/plain", data)

    def flush(self) -> None:
        self.file.flush()
        self.writer.flush()
        assert self.ours.getvalue() == self.theirs.getvalue()

    def finish(self) -> bytes:
        self.file.finish()
        self.writer.finish()
        assert self.ours.getvalue() == self.theirs.getvalue()
        return self.ours.getvalue()


def test_an_empty_file() -> None:
    assert len(Both().finish()) > 100


@pytest.mark.parametrize("seed", range(10))
def test_records_in_any_order(seed: int) -> None:
    rng, both = np.random.default_rng(seed), Both()
    channels = [both.channel("/first", b"schema", {"key": "ü"})]
    put = []
    for i in range(400):
        match rng.integers(20):
            case 0:
                both.flush()
            case 1:
                both.metadata(f"facts {i}", {"ü": "\n", str(i): ""})
            case 2:
                both.attachment(f"text {i}", i, rng.bytes(i))
            case 3:
                schema = rng.bytes(i) if i % 2 else None
                channels.append(both.channel(f"/topic/{i}", schema, {}))
            case _:
                times = rng.integers(0, 2**63, 2).tolist()  # in no order
                data = rng.bytes(int(rng.integers(300)))
                put.append((int(rng.choice(channels)), *times, data))
                both.message(*put[-1])
    reader = make_reader(BytesIO(both.finish()), validate_crcs=True)
    found = [
        (message.channel_id, message.log_time, message.publish_time, message.data)
        for _, _, message in reader.iter_messages(log_time_order=False)
    ]
    assert found == put
    summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(put)


def test_a_chunk_ends_when_it_is_large() -> None:
    both = Both()
    channel = both.channel("/large", None, {})
    both.message(channel, 3, 3, bytes(CHUNK_SIZE))
    for time_ns in (2, 1):
        both.message(channel, time_ns, 0, bytes(CHUNK_SIZE // 2))
    reader = make_reader(BytesIO(both.finish()))
    assert [message.log_time for _, _, message in reader.iter_messages()] == [1, 2, 3]
