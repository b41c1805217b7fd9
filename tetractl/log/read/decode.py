"""Decodes the messages of a log: each is charged to its budget first, and checked afterwards."""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log

from tetractl.core.commands import Command, Note
from tetractl.core.poses import Bools, Floats
from tetractl.core.text import printable
from tetractl.core.trial import Integers, Step
from tetractl.log.format import channels, codec
from tetractl.log.format import tetractl_pb2 as pb
from tetractl.log.format.scene import decode_note
from tetractl.log.read import bounds
from tetractl.log.read.bounds import TooMuchError
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.validate import (
    check_command,
    check_frames,
    check_note,
    check_step,
    check_truth,
)


class Frames(NamedTuple):
    """Camera frames in columns, as in `TrialLog`."""

    poses: Floats
    valid: Bools
    numbers: Integers
    sampled_ns: Integers
    received_ns: Integers


def frames(contents: RawLog, robots: int) -> Frames:
    """Decode the camera frames of N robots."""
    data = _messages(contents, channels.MOCAP)
    contents.budget.spend(len(data) * (4 * robots + 4) * 8, "very many camera frames")
    poses = np.empty((len(data), robots, 3))
    valid = np.empty((len(data), robots), dtype=np.bool_)
    times = np.empty((3, len(data)), dtype=np.int64)
    for i, message in enumerate(map(pb.MocapSample.FromString, data)):
        if len(message.valid) != robots:
            raise ValueError(f"a frame of {len(message.valid)} robots, not {robots}")
        _fill(poses[i], message)
        valid[i] = message.valid
        times[:, i] = message.frame, message.sampled_ns, message.received_ns
    check_frames(poses, valid, times)
    return Frames(poses, valid, *times)


def truth(contents: RawLog, numbers: Integers, robots: int) -> Floats:
    """Decode the true poses (M, N, 3) at the frames of these numbers, NaN where they are lost."""
    rows = {number: i for i, number in enumerate(numbers.tolist())}
    found = np.full((len(numbers), robots, 3), np.nan)
    spare = np.empty((robots, 3))  # for a frame that is lost
    for message in map(pb.Truth.FromString, _messages(contents, channels.TRUTH)):
        row = rows.get(message.frame)
        _fill(spare if row is None else found[row], message)
    check_truth(found)
    return found


def _fill(poses: Floats, message: pb.MocapSample | pb.Truth) -> None:
    """Write the poses of a message to an array (N, 3)."""
    counts = {len(message.x), len(message.y), len(message.heading)}
    if counts != {len(poses)}:
        raise ValueError(f"poses of {sorted(counts)} robots, not {len(poses)}")
    poses[:, 0], poses[:, 1], poses[:, 2] = message.x, message.y, message.heading


def commands(contents: RawLog, robots: int) -> Iterator[Command]:
    """Decode the commands to N robots."""
    for message in map(pb.WheelCommand.FromString, _messages(contents, channels.COMMANDS)):
        command = codec.decode_command(message)
        check_command(command, robots)
        yield command


def steps(contents: RawLog, robots: int) -> Iterator[Step]:
    """Decode the control steps of N robots, with their times of solving and estimates."""
    data = _messages(contents, channels.HOST_TIMING)
    timings = {m.k: m for m in map(pb.StepTiming.FromString, data)}
    data = _messages(contents, channels.ESTIMATE)
    estimates = {m.k: m for m in map(pb.Estimate.FromString, data)}
    for message in map(pb.ControllerStep.FromString, _messages(contents, channels.STEP)):
        searches = message.searches
        numbers = sum(len(search.signals) + len(search.history) for search in searches)
        numbers += len(message.signals) + 3 * len(message.path_x)
        cost = bounds.STEP_COST + bounds.SEARCH_COST * len(searches) + bounds.NUMBER_COST * numbers
        contents.budget.spend(cost, "very many searches")
        k = message.k
        step = codec.decode_step(message, timings.get(k), estimates.get(k), robots)
        check_step(step)
        yield step


def notes(contents: RawLog, start_unix_ns: int) -> Iterator[Note]:
    """Decode the messages for people, as text that a terminal can show."""
    for data in _messages(contents, channels.LOG):
        note = decode_note(Log.FromString(data), start_unix_ns)
        check_note(note)
        yield replace(note, text=printable(note.text, channels.TEXT))


def _messages(contents: RawLog, topic: str) -> list[bytes]:
    found = [entry.data for entry in contents.by_topic[topic]]
    longest = max(map(len, found), default=0)
    if longest > bounds.MESSAGE:
        raise TooMuchError(f"a message on {topic} has {longest} bytes")
    return found
