"""Small logs that would cost much: every command ends soon and small, or says why in a line."""

import os
import struct
import subprocess
import sys
from dataclasses import replace

import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel
from support.commands import COSTLY, READERS
from support.mutate import chunk, rewrite, stating
from support.paths import ROOT
from support.random_trials import trial, write

from tetractl.log.format.channels import FRAMES, HOST, LOG, RESOLVED_SPEC, RESULT, RUN, STEP, Entry
from tetractl.log.format.codec import decode_frames, encode_frames
from tetractl.log.format.tetractl_pb2 import CameraFrames, ControllerStep, Fact
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.salvage import scan

pytestmark = pytest.mark.slow

SECONDS, MEMORY_MB = 30, 1000


def message(channel, data):
    body = struct.pack("<HIQQ", channel, 0, 0, 0) + data
    return bytes([Opcode.MESSAGE]) + struct.pack("<Q", len(body)) + body


def before_the_end(contents, path, chunks):
    """A copy with further chunks behind its first, and no index."""
    data = contents.path.read_bytes()
    second = data.index(b"\x04\0\0\0zstd", data.index(b"\x04\0\0\0zstd") + 10) - 37
    path.write_bytes(data[:second] + b"".join(chunks) + data[second:])
    return path


def steps_of_searches(contents, path):
    """Steps that fit the run, each with very many small searches."""
    entry = next(entry for entry in contents.entries if entry.topic == STEP)
    step = ControllerStep.FromString(entry.data)
    one = step.searches[0]
    del one.history[1:]
    del step.searches[:]
    step.searches.extend([one] * 20_000)
    step.chosen = 0
    several = b"".join(message(5, step.SerializeToString()) for _ in range(5))
    return before_the_end(contents, path, [chunk(several)] * 30)


def huge_spec(contents, path):
    def asks(text):
        text = text.replace("particles: 100", "particles: 1000000")
        text = text.replace("iterations: 100", "iterations: 1000000")
        assert "particles: 1000000" in text
        return text

    return with_spec(contents, path, asks)


def with_spec(contents, path, change):
    records = []
    for record in contents.records:
        if isinstance(record, Attachment) and record.name == RESOLVED_SPEC:
            record = replace(record, data=change(record.data.decode()).encode())
        records.append(record)
    changed = RawLog(contents.path, records=records, channels=contents.channels)
    return rewrite(changed, path, {})


def far_pose(contents, path):
    entry = next(entry for entry in contents.entries if entry.topic == FRAMES)
    frames = decode_frames(CameraFrames.FromString(entry.data), len(contents.run.robots))
    frames.poses[2, 0, 0] = 1e8
    data = encode_frames(frames).SerializeToString()
    return rewrite(contents, path, {entry: entry._replace(data=data)})


EVIL = "\x1b]0;owned\x07\x9b2J\u202e=cmd\r\n"


def escapes(contents, path):
    """Escape sequences in every text that a log has."""
    entries = {}
    for entry in contents.entries:
        if entry.topic == LOG:
            note = Log.FromString(entry.data)
            note.message += EVIL
            entries[entry] = entry._replace(data=note.SerializeToString())
        elif entry.topic == STEP:
            step = ControllerStep.FromString(entry.data)
            step.searches[step.chosen].stopped = EVIL
            entries[entry] = entry._replace(data=step.SerializeToString())

    evil = [Fact(key=EVIL, value=EVIL), Fact(key="host", value=EVIL)]
    entries |= stating(contents, RUN, spec_name=EVIL, facts=evil)
    entries |= stating(contents, RESULT, reason=f"=cmd{EVIL}") | stating(contents, HOST, facts=evil)
    return rewrite(contents, path, entries)


def zeros_behind(contents, path):
    """What a power cut leaves on some file systems, 2 GB of it."""
    data = contents.path.read_bytes()
    with path.open("wb") as file:
        file.write(data[: len(data) // 2])
        file.truncate(2_000_000_000)
    return path


def endless(contents, path):
    with path.open("wb") as file:
        file.write(contents.path.read_bytes())
        file.truncate(10**12)
    return path


def only_in_the_summary(contents, path):
    """Regression: `recover` copied messages of a channel that it had not made."""
    extra = Entry("/only", 1, 1, b"data")
    first = contents.records.index(contents.entries[0])
    records = [*contents.records[:first], extra, *contents.records[first:]]
    records.insert(first + 40, extra)  # the first takes the record of the channel with it
    more = {"/only": (Channel(77, "/only", "none", {}, 0), None)}
    changed = RawLog(contents.path, records=records, channels=contents.channels | more)
    whole = path.with_suffix(".whole")
    rewrite(changed, whole, {}, apart=True)
    data = bytearray(whole.read_bytes())
    data[data.index(b"\x04\0\0\0zstd") + 60] ^= 1
    path.write_bytes(data)
    return path


QUICK = [huge_spec, far_pose, escapes, only_in_the_summary]
SLOW = [zeros_behind, endless]


@pytest.fixture(scope="module")
def contents(tmp_path_factory):
    folder = tmp_path_factory.mktemp("log")
    return scan(write(trial(steps=12, robots=2, index=1), folder / "trial.mcap"))


@pytest.mark.parametrize(
    ("builders", "commands"),
    [
        (QUICK, COSTLY),
        ([steps_of_searches], READERS),
        pytest.param(SLOW, COSTLY, marks=pytest.mark.system),
    ],
)
def test_a_log_costs_its_reader_little(contents, tmp_path, builders, commands):
    """All in one process of its own, whose most memory is bounded."""
    paths = [build(contents, tmp_path / f"{build.__name__}.mcap") for build in builders]
    (tmp_path / "out").mkdir()
    script = ROOT / "tests" / "support" / "commands.py"
    done = subprocess.run(
        [sys.executable, script, tmp_path / "out", ",".join(commands), *paths],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")])},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == len(paths) * len(commands)
    for line in lines:
        name, seconds, memory = line.split("\t")
        assert float(seconds) < SECONDS, name
        assert float(memory) < MEMORY_MB, name


def test_too_few_addresses_are_one_line():
    """Regression: OpenBLAS asked for memory without end, in an import that no signal ends."""
    done = subprocess.run(
        ["bash", "-c", f"ulimit -v 400000; exec '{sys.executable}' -m tetractl stats x"],
        capture_output=True, text=True, timeout=300, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    first, hint = done.stderr.splitlines()
    assert first == "error: 410 MB of address space are allowed, 1000 are needed"
    assert (done.returncode, hint) == (1, "  hint: ulimit -v unlimited")
