"""Tests that every command ends with a one-line reason for any broken log."""

import os
import subprocess
import sys
from dataclasses import replace

import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log
from mcap.records import Attachment
from testkit.commands import COMMANDS, check
from testkit.mutate import rewrite, stating
from testkit.paths import ROOT
from testkit.random_trials import trial, write

from tetractl.log.format.channels import (
    CHANNELS,
    FRAMES,
    HOST,
    LOG,
    RESOLVED_SPEC,
    RESULT,
    RUN,
    STEP,
)
from tetractl.log.format.codec import decode_frames, encode_frames
from tetractl.log.format.tetractl_pb2 import CameraFrames, ControllerStep, Fact
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.salvage import scan

pytestmark = pytest.mark.slow


def huge_spec(contents, path):
    def asking(record):
        if not isinstance(record, Attachment) or record.name != RESOLVED_SPEC:
            return record
        text = record.data.replace(b"particles: 100", b"particles: 1000000")
        return replace(record, data=text.replace(b"iterations: 100", b"iterations: 1000000"))

    records = [asking(record) for record in contents.records]
    assert records != contents.records
    return rewrite(RawLog(path, records=records, channels=contents.channels), path, {})


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


@pytest.fixture(scope="module")
def contents(tmp_path_factory):
    folder = tmp_path_factory.mktemp("log")
    return scan(write(trial(steps=12, robots=2, index=1), folder / "trial.mcap"))


@pytest.mark.long
@pytest.mark.parametrize("build", [huge_spec, far_pose, escapes])
def test_a_log_from_anybody_is_read_or_told_in_a_line(build, contents, tmp_path):
    log = build(contents, tmp_path / "hostile.mcap")
    for command in COMMANDS:
        check(command, log, tmp_path / "out")


@pytest.mark.parametrize("topic", [*CHANNELS])
def test_a_message_that_is_none_is_told_in_a_line(topic, contents, tmp_path):
    """Regression: `info`, which looks into few of the messages, and `verify`, which makes the
    host's again, ended in tracebacks."""
    entries = contents.entries_by_topic.get(topic, ())
    spoilt = {entry: entry._replace(data=b"\xff" * 4) for entry in entries}
    log = rewrite(contents, tmp_path / "hostile.mcap", spoilt)
    for command in ("info", "info --json", "verify"):
        check(command, log, tmp_path / "out")


def test_too_few_addresses_are_one_line():
    """Regression: OpenBLAS asked for memory without end, in an import that no signal ends."""
    done = subprocess.run(
        ["bash", "-c", f"ulimit -v 400000; exec '{sys.executable}' -m tetractl stats x"],
        capture_output=True, text=True, timeout=300, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    first, hint = done.stderr.splitlines()
    assert first == "error: the address space is limited to 410 MB, but tetractl needs 1000 MB"
    assert (done.returncode, hint) == (1, "  hint: remove the limit with: ulimit -v unlimited")
