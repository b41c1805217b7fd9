"""Logs from anybody: damaged at random, made to burst, or made to lie."""

import os
import random
import re
import struct
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from support.fuzz import Original, fuzz
from support.mutate import chunk, rewrite, stating
from support.random_trials import trial, write

from tetractl.core.errors import LogError, TetractlError
from tetractl.log.format.channels import COMMANDS, FRAMES, HOST_END, HOST_TIMING, RESULT, RUN, STEP
from tetractl.log.format.codec import packed
from tetractl.log.format.tetractl_pb2 import (
    CameraFrames,
    ControllerStep,
    MocapSample,
    Search,
    StepTiming,
    WheelCommand,
)
from tetractl.log.read import limits
from tetractl.log.read.overview import overview
from tetractl.log.read.reader import read_result, read_trial
from tetractl.log.read.recover import recover
from tetractl.log.read.salvage import scan
from tetractl.replay.verify import verify
from tetractl.results.open_batch import counts, open_batch

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """Small, so that most bytes matter."""
    made = trial(steps=12, robots=1, frames=2, first=2, iterations=3, length=3)
    return write(made, tmp_path_factory.mktemp("log") / "trial.mcap")


@pytest.fixture(scope="module")
def contents(log):
    return scan(log)


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
    found = scan(with_chunks(log, tmp_path / "bomb.mcap", [bomb]))
    assert any("claims to unpack to 16777217 bytes" in problem for problem in found.problems)
    assert found.entries == scan(log).entries


def test_a_frame_that_hides_its_size_stops_at_what_the_chunk_says(log, tmp_path):
    hidden = zstandard.ZstdCompressor(write_content_size=False).compress(b"\0" * (1 << 24))
    found = scan(with_chunks(log, tmp_path / "bomb.mcap", [chunk(b"", 100, hidden)]))
    assert found.entries == scan(log).entries
    assert found.problems


def test_many_chunks_together_are_bounded(log, tmp_path):
    padding = bytes([0x80]) + struct.pack("<Q", 15_000_000) + b"\0" * 15_000_000
    path = with_chunks(log, tmp_path / "many.mcap", [chunk(padding)] * 60)
    assert path.stat().st_size < 200_000
    with pytest.raises(LogError, match="unpack to very many bytes, more than tetractl reads"):
        scan(path)


def test_records_that_claim_the_same_bytes_are_not_all_read(log, tmp_path, monkeypatch):
    """Each of these would copy the rest of the file: quadratic, were it not for the limit."""
    trace = bytes(28) + b"\x04\0\0\0zstd" + struct.pack("<Q", 1 << 19)
    path = tmp_path / "overlap.mcap"
    path.write_bytes(log.read_bytes()[:-100] + trace * 12_000)
    found = scan(path)
    assert len(found.entries) == len(scan(log).entries)
    monkeypatch.setattr(limits, "OVERLAP", 0)
    assert scan(path).entries == []


def test_a_tail_of_zeros_is_an_end(log, tmp_path):
    """What a power cut leaves on some file systems."""
    path = tmp_path / "zeros.mcap"
    half = log.read_bytes()[: log.stat().st_size // 2]
    path.write_bytes(half + bytes(5_000_000))
    found = re.search(r"breaks off in the record at byte (\d+)", " ".join(scan(path).problems))
    assert found
    assert int(found[1]) < len(half) + 10_000


NAN, INF = float("nan"), float("inf")


def spoilt_frames(times=((0, 0, 0),), poses=((1.0, 1.0, 1.0),), truth=(), valid=(True,)):
    """Frames of one robot that could be ours, but for the changes."""
    return CameraFrames(
        times=packed(np.array(times, np.int64)),
        poses=packed(np.array(poses, np.float64).reshape(-1, 3)),
        truth=packed(np.array(truth, np.float32).reshape(-1, 3)),
        valid=valid,
    )


def spoilt_step(**changes):
    """A step of one robot that could be ours, but for the changes."""
    seen = MocapSample(x=[1.0], y=[1.0], heading=[1.0], valid=[True])
    one = Search(length=1, signals=[0.5], cost=1.0, history=[1.0], evaluations=1)
    command = WheelCommand(direction=0.5, delivered=[True])
    path = {"path_x": [1.0] * 2, "path_y": [1.0] * 2}
    whole = {"observation": seen, "searches": [one], "command": command, "signals": [0.5], **path}
    whole["state"] = "driving"
    return ControllerStep(**{**whole, **changes})


@pytest.mark.parametrize(
    ("topic", "changes"),
    [
        (HOST_END, {"solve_ns": [-1]}),
        (HOST_END, {"deadline_misses": -1}),
        (RESULT, {"total_error": INF}),
        (RESULT, {"total_error": NAN}),
        (RESULT, {"robot_errors": [1.0, 2.0]}),
        (RESULT, {"duration_s": INF}),
        (RESULT, {"duration_s": -1.0}),
        (RESULT, {"steps": -1}),
        (RESULT, {"final_x": [NAN]}),
        (RESULT, {"final_x": [1e300]}),
        (RESULT, {"clearance": [NAN]}),
        (RESULT, {"turn": [0.1]}),
        (RESULT, {"turn_std": [0.1]}),
        (RESULT, {"turn": [NAN], "turn_std": [0.1]}),
        (RESULT, {"turn": [0.1], "turn_std": [-0.1]}),
        (RESULT, {"entered": []}),
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
    assert not counts(bad)
    log = read_trial(tmp_path / "bad.mcap")
    assert log.damage
    assert any("values that tetractl does not write" in problem for problem in log.damage.problems)
    assert verify(tmp_path / "bad.mcap").problems


@pytest.mark.parametrize(
    "changes",
    [
        {"robots": ["a", "b"]},
        {"camera_rate_hz": NAN},
        {"camera_rate_hz": -1.0},
        {"start_unix_ns": 2**63 - 1},
        {"start_unix_ns": -1},
        {"trial": 2**62},
        {"format_version": -1},
    ],
)
def test_a_bad_run_costs_its_own_trial_only(tmp_path, contents, changes):
    edited = stating(contents, RUN, **changes)
    rewrite(contents, tmp_path / "bad.mcap", edited)
    write(trial(steps=3, robots=1, index=2), tmp_path / "good.mcap")
    batch = open_batch([tmp_path])
    assert len(batch.trials) == 1
    assert [Path(log.path).name for log in batch.damaged] == ["bad.mcap"]


@pytest.mark.parametrize("topic", [RUN, RESULT, HOST_END])
def test_a_record_of_the_run_that_is_no_message_is_one_line(tmp_path, contents, topic):
    entry = contents.by_topic[topic][0]
    torn = {entry: entry._replace(data=entry.data[:-1] + b"\xff")}
    path = rewrite(contents, tmp_path / "trial.mcap", torn)
    for read in (read_trial, read_result, overview, verify):
        try:
            found = read(path)
        except TetractlError as error:
            assert "\n" not in str(error)
        else:
            assert read is not verify or found.problems


@pytest.mark.parametrize(
    ("topic", "message"),
    [
        (FRAMES, spoilt_frames(poses=[[1.0] * 3] * 3, valid=[True] * 3)),
        (FRAMES, spoilt_frames(poses=())),
        (FRAMES, spoilt_frames(times=[(0, 1, 1), (1, 2, 2)])),
        (FRAMES, spoilt_frames(truth=[[1.0] * 3] * 2)),
        (FRAMES, spoilt_frames(valid=())),
        (FRAMES, CameraFrames(times=b"abc")),
        (FRAMES, CameraFrames(truth=b"abc")),
        (STEP, ControllerStep(chosen=5)),
        (STEP, ControllerStep(chosen=-1, signals=[1.0])),
        (FRAMES, spoilt_frames(poses=[(NAN, 1.0, 1.0)])),
        (FRAMES, spoilt_frames(poses=[(INF, 1.0, 1.0)], valid=[False])),
        (FRAMES, spoilt_frames(poses=[(1.0, 1.0, 1e300)])),
        (FRAMES, spoilt_frames(times=[(0, 2**62, 0)])),
        (FRAMES, spoilt_frames(truth=[(INF, 1.0, 1.0)])),
        (COMMANDS, WheelCommand(direction=NAN, delivered=[True])),
        (COMMANDS, WheelCommand(direction=1.0, delivered=[True], sent_ns=-(2**63))),
        (COMMANDS, WheelCommand(direction=1.0)),
        (COMMANDS, WheelCommand(direction=1.0, delivered=[True], left=[1.0, 2.0])),
        (HOST_TIMING, StepTiming(k=0, solve_ns=-1)),
        (STEP, spoilt_step(k=-1)),
        (STEP, spoilt_step(cost=INF)),
        (STEP, spoilt_step(signals=[NAN])),
        (STEP, spoilt_step(path_x=[1.0, NAN])),
        (STEP, spoilt_step(path_x=[1.0] * 3, path_y=[1.0] * 3)),
        (STEP, spoilt_step(searches=[Search(length=1, signals=[0.5], cost=1.0)])),
        (STEP, spoilt_step(searches=[Search(length=2, signals=[0.5], history=[1.0])])),
        (STEP, spoilt_step(searches=[Search(length=1, signals=[0.5], history=[-INF])])),
    ],
)
def test_a_message_that_tetractl_would_not_write_is_refused(tmp_path, contents, topic, message):
    """Regression: replay, plot and verify ended with tracebacks."""
    entry = next(entry for entry in contents.entries if entry.topic == topic)
    new = entry._replace(data=message.SerializeToString())
    path = rewrite(contents, tmp_path / "trial.mcap", {entry: new})
    with pytest.raises(LogError, match="contains a value that tetractl does not write"):
        read_trial(path)


def test_the_step_that_is_spoilt_there_is_good_otherwise(tmp_path, contents):
    entry = next(entry for entry in contents.entries if entry.topic == STEP)
    new = entry._replace(data=spoilt_step().SerializeToString())
    assert read_trial(rewrite(contents, tmp_path / "trial.mcap", {entry: new})).steps


@pytest.mark.parametrize("name", ["../../escape", "/tmp/escape", "a/b", "..", "nul\0", "x" * 5000])
def test_names_in_a_log_are_no_paths(tmp_path, log, name):
    """An attachment of that name is carried along inside the log, and nothing else is written."""
    builder = RecordBuilder()
    from mcap.records import Attachment

    Attachment(0, 0, name, "application/yaml", b"evil").write(builder)
    folder = tmp_path / "a" / "b"
    folder.mkdir(parents=True)
    path = with_chunks(log, folder / "trial.mcap", [builder.end()])
    out = recover(path)
    assert "evil" in [item.data.decode() for item in scan(Path(str(out.path))).attachments.values()]
    left = {str(Path(root, file)) for root, _, files in os.walk(tmp_path) for file in files}
    assert left == {str(path), str(out.path)}
