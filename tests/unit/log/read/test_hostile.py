"""Tests of hostile logs: randomly damaged, much too large, or with false contents."""

import random
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Attachment
from testkit.fuzz import Original, fuzz
from testkit.mutate import chunk, rewrite, stating
from testkit.random_trials import trial, write

from tetractl.core.errors import LogError, TetractlError
from tetractl.log.format.channels import COMMANDS, FRAMES, HOST_END, RESULT, RUN, STEP
from tetractl.log.format.packed_columns import pack_columns
from tetractl.log.format.tetractl_pb2 import (
    CameraFrames,
    ControllerStep,
    MocapSample,
    Number,
    Search,
    WheelCommand,
)
from tetractl.log.read import limits, raw_log, salvage
from tetractl.log.read.overview import overview
from tetractl.log.read.reader import read_result, read_trial
from tetractl.log.read.recover import recover
from tetractl.log.read.salvage import peek, scan
from tetractl.statistics.open_batch import is_counted, open_batch
from tetractl.verification.verify import verify

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """Small, so that most bytes matter."""
    random_trial = trial(steps=12, robots=1, frames=2, first=2, iterations=3, length=3)
    return write(random_trial, tmp_path_factory.mktemp("log") / "trial.mcap")


@pytest.fixture(scope="module")
def contents(log):
    return scan(log)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["truncated", "flipped"])
def test_a_damaged_log_is_read_as_far_as_it_is_good(log, tmp_path, kind):
    """Ten thousand of each in benchmarks/log.py."""
    original = Original(log)
    assert len(original.chunks) > 2
    copies = getattr(original, kind)(150, random.Random(5))
    tally = fuzz(original, copies, tmp_path / "copy.mcap")
    assert tally.wrong == []
    assert tally.chunks_recovered == tally.chunks_complete > 100


def with_chunks(log, path, chunks):
    """A copy with chunks put before the first one."""
    data = log.read_bytes()
    first = data.index(b"\x04\0\0\0zstd") - 37
    path.write_bytes(data[:first] + b"".join(chunks) + data[first:])
    return path


@pytest.mark.parametrize("said", [None, 100])
def test_a_bomb_is_not_unpacked(log, tmp_path, said):
    bomb = chunk(b"\0" * (limits.CHUNK_MAX + 1), said)
    assert len(bomb) < 10_000
    contents = scan(with_chunks(log, tmp_path / "bomb.mcap", [bomb]))
    assert any(
        "states an unpacked size of 16777217 bytes" in problem for problem in contents.problems
    )
    assert contents.entries == scan(log).entries


def test_the_search_of_a_damaged_file_ends(log, contents, tmp_path, monkeypatch):
    """Each of these would copy the rest of the file: quadratic, were it not for the limit."""
    trace = bytes(28) + b"\x04\0\0\0zstd" + struct.pack("<Q", 1 << 19)
    path = tmp_path / "overlap.mcap"
    path.write_bytes(log.read_bytes()[:-100] + trace * 1000)
    assert len(scan(path).entries) == len(contents.entries)
    monkeypatch.setattr(salvage, "seconds_limit", lambda: -1)
    with pytest.raises(LogError, match="very many records, or very many damaged ones"):
        scan(path)


@pytest.mark.parametrize("opcode", [*Opcode, 0x80])
def test_a_record_is_decoded_from_its_own_bytes(log, contents, tmp_path, opcode):
    """Regression: an empty record of metadata was decoded from what followed it, and the time to
    read very many of them grew with the square of their number."""
    empty = struct.pack("<BQ", opcode, 0)
    text_of_264 = struct.pack("<BQ", Opcode.MESSAGE_INDEX, 1) + b"\0"  # if these are its bytes
    zeros = struct.pack("<BQ", Opcode.MESSAGE_INDEX, 300) + bytes(300)
    data = log.read_bytes()
    end_of_header = len(salvage.MAGIC) + 9 + int.from_bytes(data[9:17], "little")
    path = tmp_path / "empty.mcap"
    path.write_bytes(data[:end_of_header] + empty + text_of_264 + zeros + data[end_of_header:])
    again = scan(path)
    assert again.problems
    assert again.library == contents.library
    assert again.records == contents.records
    assert again.channels == contents.channels


def test_a_larger_file_is_read_if_the_factor_says_so(log, monkeypatch):
    """A limit on forged logs never costs an honest one."""
    monkeypatch.setattr(raw_log, "file_limit", lambda: log.stat().st_size - 1)
    with pytest.raises(
        LogError, match="to double the limit, set the environment variable TETRACTL"
    ):
        scan(log)
    monkeypatch.undo()
    before = limits.file_limit(), limits.seconds_limit()
    monkeypatch.setenv(limits.FACTOR_VARIABLE, "2")
    assert (limits.file_limit(), limits.seconds_limit()) == (2 * before[0], 2 * before[1])
    for useless in ("nan", "0.1", "much"):
        monkeypatch.setenv(limits.FACTOR_VARIABLE, useless)
        assert limits.file_limit() == before[0]


def test_an_index_that_cannot_be_read_is_left_out(log, tmp_path):
    """Its checksum fits, but a channel in it is no record."""
    data = log.read_bytes()
    footer = len(data) - len(salvage.MAGIC) - 20
    begin = int.from_bytes(data[footer : footer + 8], "little")
    broken = bytes([Opcode.CHANNEL]) + struct.pack("<QI", 4, 1 << 30)
    index = (begin - 50).to_bytes(8, "little")  # where the data section now is cut off
    tail = broken + data[footer - 9 : footer] + index + data[footer + 8 : footer + 16]
    crc = struct.pack("<I", zlib.crc32(tail))
    path = tmp_path / "index.mcap"
    path.write_bytes(data[: begin - 50] + tail + crc + salvage.MAGIC)
    assert scan(path).entries == scan(log).entries


def with_first(contents, folder, topic, data):
    """Write the log with other data in its first message of a topic; return its path."""
    first = contents.entries_by_topic[topic][0]
    return rewrite(contents, folder / "trial.mcap", {first: first._replace(data=data)})


NAN = float("nan")
INF = float("inf")


def spoilt_frames(times=((0, 0, 0),), poses=((1.0, 1.0, 1.0),), truth=(), valid=(True,)):
    """Frames of one robot that could be ours, but for the changes."""
    return CameraFrames(
        times=pack_columns(np.array(times, np.int64)),
        poses=pack_columns(np.array(poses, np.float64).reshape(-1, 3)),
        truth=pack_columns(np.array(truth, np.float32).reshape(-1, 3)),
        valid=valid,
    )


def spoilt_step(**changes):
    """A step of one robot that could be ours, but for the changes."""
    fields = {
        "observation": MocapSample(x=[1.0], y=[1.0], heading=[1.0], valid=[True]),
        "searches": [Search(length=1, signals=[0.5], cost=1.0, history=[1.0], evaluations=1)],
        "command": WheelCommand(direction=0.5, delivered=[True]),
        "signals": [0.5],
        "path_x": [1.0, 1.0],
        "path_y": [1.0, 1.0],
        "state": "driving",
    }
    return ControllerStep(**(fields | changes))


@pytest.mark.parametrize(
    ("topic", "changes"),
    [
        (RESULT, {"total_error": INF}),
        (RESULT, {"robot_errors": [1.0, 2.0]}),
        (RESULT, {"duration_s": NAN}),
        (RESULT, {"clearance": [NAN]}),
        (RESULT, {"outcome": "triumph"}),
        (RESULT, {"unit": "furlong"}),
    ],
)
def test_a_bad_result_costs_its_own_trial_only(tmp_path, contents, topic, changes):
    """Regression: one such log ended `stats` of a whole batch with a traceback."""
    rewrite(contents, tmp_path / "bad.mcap", stating(contents, topic, **changes))
    write(trial(steps=3, robots=1, index=2), tmp_path / "good.mcap")
    batch = open_batch([tmp_path])
    bad, good = batch.trials
    assert (bad.recovered, good.recovered, batch.damaged) == (True, False, ())
    assert not is_counted(bad)
    log = read_trial(tmp_path / "bad.mcap")
    assert log.damage
    assert any("values that tetractl never writes" in problem for problem in log.damage.problems)
    assert verify(tmp_path / "bad.mcap").problems


@pytest.mark.parametrize(
    ("topic", "message"),
    [
        (FRAMES, spoilt_frames(poses=[[1.0] * 3] * 3, valid=[True] * 3)),
        (FRAMES, spoilt_frames(times=[(0, 1, 1), (1, 2, 2)])),
        (FRAMES, spoilt_frames(valid=())),
        (FRAMES, CameraFrames(times=b"abc")),
        (STEP, ControllerStep(chosen=-1, signals=[1.0])),
        (FRAMES, spoilt_frames(poses=[(NAN, 1.0, 1.0)])),
        (FRAMES, spoilt_frames(poses=[(INF, 1.0, 1.0)], valid=[False])),
        (FRAMES, spoilt_frames(truth=[(INF, 1.0, 1.0)])),
        (COMMANDS, WheelCommand(direction=NAN, delivered=[True])),
        (COMMANDS, WheelCommand(direction=1.0, delivered=[True], left=[1.0, 2.0])),
        (STEP, spoilt_step(cost=INF)),
        (STEP, spoilt_step(numbers=[Number(name="margin_mm", value=NAN)])),
        (STEP, spoilt_step(numbers=[Number(name="margin\n", value=1.0)])),
        (STEP, spoilt_step(path_x=[1.0, NAN])),
        (STEP, spoilt_step(path_x=[1.0] * 3, path_y=[1.0] * 3)),
        (STEP, spoilt_step(searches=[Search(length=2, signals=[0.5], history=[1.0])])),
        (STEP, spoilt_step(searches=[Search(length=1, signals=[0.5], history=[-INF])])),
    ],
)
def test_a_message_that_tetractl_would_not_write_is_refused(tmp_path, contents, topic, message):
    """Regression: replay, plot and verify ended with tracebacks."""
    path = with_first(contents, tmp_path, topic, message.SerializeToString())
    with pytest.raises(LogError, match="contains a value that tetractl never writes"):
        read_trial(path)


def test_the_step_that_is_spoilt_there_is_good_otherwise(tmp_path, contents):
    assert read_trial(with_first(contents, tmp_path, STEP, spoilt_step().SerializeToString())).steps


@pytest.mark.parametrize("name", ["../../escape", "/tmp/escape", "nul\0", "x" * 5000])
def test_names_in_a_log_are_no_paths(tmp_path, log, name):
    """An attachment of that name is carried along inside the log, and nothing else is written."""
    builder = RecordBuilder()
    Attachment(0, 0, name, "application/yaml", b"evil").write(builder)
    path = with_chunks(log, tmp_path / "trial.mcap", [builder.end()])
    out = Path(str(recover(path).path))
    assert b"evil" in [attachment.data for attachment in scan(out).attachments.values()]
    assert {*tmp_path.rglob("*")} == {path, out}


PADDING = bytes([0x80]) + struct.pack("<Q", 15_000_000) + b"\0" * 15_000_000


EMPTY = bytes([Opcode.MESSAGE]) + struct.pack("<QHIQQ", 22, 1, 0, 0, 0)


@pytest.mark.long
@pytest.mark.parametrize("inside", [PADDING, EMPTY * 60_000])
def test_many_chunks_together_are_bounded(log, tmp_path, inside):
    path = with_chunks(log, tmp_path / "many.mcap", [chunk(inside)] * 20)
    assert path.stat().st_size < 200_000
    with pytest.raises(LogError, match="very many bytes or messages in its chunks, more than"):
        scan(path)


def test_every_record_of_a_chunk_counts_towards_its_limit(log, tmp_path, monkeypatch):
    """Regression: only messages did; a file of 30 kB, of 14 million channels, took 48 s."""
    channel = bytes([Opcode.CHANNEL]) + struct.pack("<QHHIII", 16, 1, 1, 0, 0, 0)
    path = with_chunks(log, tmp_path / "channels.mcap", [chunk(channel * 1000)])
    monkeypatch.setattr(salvage, "file_limit", lambda: 250_000)
    assert scan(log).entries
    with pytest.raises(LogError, match="very many bytes or messages in its chunks, more than"):
        scan(path)


def test_all_of_the_reading_of_a_file_counts_towards_its_limit(log, monkeypatch):
    assert peek(log) is not None
    monkeypatch.setattr(salvage, "seconds_limit", lambda: -1)
    for read in (scan, peek):  # though nothing is damaged
        with pytest.raises(LogError, match="very many records"):
            read(log)


@pytest.mark.parametrize(
    "changes",
    [
        {"robots": ["a", "b"]},
        {"camera_rate_hz": NAN},
        {"format_version": -1},
    ],
)
def test_a_bad_run_costs_its_own_trial_only(tmp_path, contents, changes):
    rewrite(contents, tmp_path / "bad.mcap", stating(contents, RUN, **changes))
    write(trial(steps=3, robots=1, index=2), tmp_path / "good.mcap")
    batch = open_batch([tmp_path])
    assert len(batch.trials) == 1
    assert [Path(log.log).name for log in batch.damaged] == ["bad.mcap"]


@pytest.mark.parametrize("topic", [RUN, RESULT, HOST_END])
def test_a_record_of_the_run_that_is_no_message_is_one_line(tmp_path, contents, topic):
    first = contents.entries_by_topic[topic][0]
    path = with_first(contents, tmp_path, topic, first.data[:-1] + b"\xff")
    for read in (read_trial, read_result, overview, verify):
        try:
            answer = read(path)
        except TetractlError as error:
            assert "\n" not in str(error)
        else:
            assert read is not verify or answer.problems
