"""The digest of a trial: a hash of its records, however and wherever a log stores them.

A content digest is over the bytes of a log, with the messages that only repeat for Foxglove what
others hold. A study keeps trials without logs, and would spend a quarter of their time on encoding
for a hash: its rows state this digest, which a trial as it runs and its log read back both give.
"""

import hashlib
from collections.abc import Iterable, Mapping
from struct import pack

import numpy as np
from numpy.typing import NDArray

from tetractl.core.commands import Command, Note, Sample
from tetractl.core.plan import Estimate, Plan
from tetractl.core.poses import Bools, Floats, Observation, Poses
from tetractl.core.text import printable
from tetractl.core.trial import Result, Start, Step
from tetractl.log.format.channels import TEXT
from tetractl.log.format.codec import STOPPED
from tetractl.log.format.metadata import FORMAT, result_metadata, run_metadata

Integers = NDArray[np.int64]
FLOAT64, INT64 = np.dtype("<f8"), np.dtype("<i8")
BLOCK = 10_000  # frames hashed at a time


class TrialDigest:
    """SHA-256 over the records of one trial of N robots but the times of solving.

    Frames, commands, control steps and messages for people each have a hash of their own, in their
    order; the digest is over those and over start and result, so that it makes no difference how
    the kinds follow one another. Numbers are hashed as little-endian float64 and int64, and texts
    for people as a log gives them back: in characters that a terminal can show, and cut.
    """

    def __init__(self, start: Start) -> None:
        self._unit = start.setup.unit
        stated = run_metadata(start)
        del stated[FORMAT]  # how a log stores a trial is none of its records
        attached = [text for pair in start.attached for text in pair]
        texts = (start.spec_text, start.resolved, *attached)
        self._first = hashlib.sha256(_items(stated) + b"".join(map(_text, texts)))
        self._frames, self._commands = hashlib.sha256(), hashlib.sha256()
        self._steps, self._notes = hashlib.sha256(), hashlib.sha256()

    def samples(self, samples: Iterable[Sample]) -> None:
        """Add camera frames, with the true poses where they are known."""
        self._frames.update(b"".join([_sample(sample) for sample in samples]))

    def frames(self, numbers: Integers, poses: Floats, valid: Bools, truth: Floats | None) -> None:
        """Add M camera frames in columns, with the same effect as their `samples`.

        `numbers` (M, 3) are the frames' numbers, times of exposure and times received [ns], `poses`
        and `truth` (M, N, 3), `valid` (M, N).
        """
        count = len(numbers)
        for begin in range(0, count, BLOCK):
            part = slice(begin, begin + BLOCK)
            known = np.full((len(numbers[part]), 1), truth is not None)
            columns = [numbers[part].astype(INT64), known, _by_axis(poses[part]), valid[part]]
            if truth is not None:
                columns.append(_by_axis(truth[part]))
            data = [np.ascontiguousarray(column).view(np.uint8) for column in columns]
            self._frames.update(np.concatenate(data, axis=1).tobytes())

    def command(self, command: Command) -> None:
        """Add a command: of a control step, between two, or the stop."""
        self._commands.update(
            pack("<q?", command.sent_ns, command.stops)
            + _flags(command.delivered)
            + _numbers(command.direction, command.left, command.right)
        )

    def step(self, step: Step) -> None:
        """Add a control step: what was observed and decided, without its command."""
        self._steps.update(pack("<q", step.k) + _observation(step.observation) + _plan(step.plan))

    def note(self, note: Note) -> None:
        """Add a message for people."""
        text = printable(note.text, TEXT)
        self._notes.update(pack("<q", note.t_ns) + _text(note.level) + _text(text))

    def hexdigest(self, result: Result | None) -> str:
        """Return the digest of the trial with its result, None where it has none."""
        last = hashlib.sha256()
        if result is not None:
            items = result_metadata(result, self._unit)
            last.update(_items({**items, "reason": printable(result.reason, TEXT)}))
        kinds = (self._first, self._frames, self._commands, self._steps, self._notes, last)
        return hashlib.sha256(b"".join([kind.digest() for kind in kinds])).hexdigest()


def _sample(sample: Sample) -> bytes:
    seen, truth = sample.observation, sample.truth
    head = pack("<qqq?", seen.frame, seen.sampled_ns, seen.received_ns, truth is not None)
    measured = head + _poses(seen.poses) + _flags(seen.valid)
    return measured if truth is None else measured + _poses(truth)


def _observation(seen: Observation) -> bytes:
    head = pack("<qqq", seen.frame, seen.sampled_ns, seen.received_ns)
    return head + _poses(seen.poses) + _flags(seen.valid)


def _poses(poses: Poses) -> bytes:
    return _bytes(poses.x) + _bytes(poses.y) + _bytes(poses.heading)


def _by_axis(poses: Floats) -> Floats:
    """Return poses (M, N, 3) as (M, 3 N): x of every robot, then y, then heading."""
    return poses.transpose(0, 2, 1).reshape(len(poses), -1).astype(FLOAT64)


def _plan(plan: Plan) -> bytes:
    """Return a plan; that the field is off is told by the command."""
    costs = (plan.cost, plan.target_cost, plan.obstacle_cost)
    parts = [
        pack("<qqQ", len(plan.searches), plan.chosen, plan.generator),
        _numbers(*costs, plan.signals, plan.path, *_estimate(plan.estimate)),
    ]
    for search in plan.searches:
        parts.append(pack("<qq", search.length, search.evaluations))
        parts.append(_text(printable(search.stopped, STOPPED)))
        parts.append(_numbers(search.cost, search.signals, search.history))
    return b"".join(parts)


def _estimate(estimate: Estimate | None) -> tuple[Floats | float | None, ...]:
    if estimate is None:
        return ()
    return (
        *(estimate.a, estimate.a_std, estimate.speed, estimate.speed_std),
        *(estimate.heading_bias, estimate.heading_bias_std),
        *(estimate.dead_time, estimate.dead_time_std),
    )


def _numbers(*values: Floats | float | None) -> bytes:
    """Return numbers and arrays of them, each after its count; -1 for None."""
    parts = [pack("<q", len(values))]
    for value in values:
        if value is None:
            parts.append(pack("<q", -1))
        else:
            data = _bytes(value)
            parts += (pack("<q", len(data) // FLOAT64.itemsize), data)
    return b"".join(parts)


def _bytes(value: Floats | float) -> bytes:
    """Return numbers as a log stores them, whatever a plugin's arrays are of."""
    return np.asarray(value, dtype=FLOAT64).tobytes()


def _flags(value: Bools | tuple[bool, ...]) -> bytes:
    return np.asarray(value, dtype=np.bool_).tobytes()


def _items(items: Mapping[str, str]) -> bytes:
    pairs = [_text(text) for pair in sorted(items.items()) for text in pair]
    return pack("<q", len(pairs)) + b"".join(pairs)


def _text(text: str) -> bytes:
    data = text.encode()
    return pack("<q", len(data)) + data
