"""The digest of a trial: a hash of its records, however and wherever a log stores them.

A content digest is over the bytes of a log, with the messages that only repeat for Foxglove what
others hold. A study keeps trials without logs, and would spend a quarter of their time on encoding
for a hash: its rows state this digest, which a trial as it ran (`Recorder`) and its log read back
both give.
"""

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from struct import pack

import numpy as np

from tetractl.core.commands import Command, Note
from tetractl.core.plan import Estimate, Plan
from tetractl.core.poses import Bools, Floats, Observation, Poses
from tetractl.core.text import printable
from tetractl.core.trial import Step, TrialRecords
from tetractl.log.format.channels import TEXT
from tetractl.log.format.codec import STOPPED
from tetractl.log.format.metadata import FORMAT, result_metadata, run_metadata

FLOAT64, INT64 = np.dtype("<f8"), np.dtype("<i8")
BLOCK = 10_000  # frames hashed at a time


def trial_digest(trial: TrialRecords) -> str:
    """Return SHA-256 over the records of a trial of N robots but the times of solving.

    Frames, commands, control steps and operator messages each have a hash of their own, in their
    order; the digest is over those and over start and result. Numbers are hashed as little-endian
    float64 and int64, and texts for people as a log gives them back: in characters that a terminal
    can show, and cut. That of a damaged log is another one than the trial had as it ran.
    """
    start, result, last = trial.start, trial.result, b""
    stated = run_metadata(start)
    del stated[FORMAT]  # how a log stores a trial is none of its records
    attached = [text for pair in start.attached for text in pair]
    texts = (start.spec_text, start.resolved, *attached)
    if result is not None:
        items = result_metadata(result, start.setup.unit)
        last = _items({**items, "reason": printable(result.reason, TEXT)})
    kinds: tuple[Iterable[bytes], ...] = (
        (_items(stated), *map(_text, texts)),
        _frames(trial),
        map(_command, trial.commands),
        map(_step, trial.steps),
        map(_note, trial.notes),
        (last,),
    )
    return hashlib.sha256(b"".join(map(_hash, kinds))).hexdigest()


def _hash(parts: Iterable[bytes]) -> bytes:
    found = hashlib.sha256()
    for part in parts:
        found.update(part)
    return found.digest()


def _frames(trial: TrialRecords) -> Iterator[bytes]:
    """Yield the camera frames, a block at a time."""
    truth = trial.truth
    for begin in range(0, len(trial.frames), BLOCK):
        part = slice(begin, begin + BLOCK)
        numbers = (trial.frames[part], trial.mocap_ns[part], trial.received_ns[part])
        known = np.full((len(numbers[0]), 1), truth is not None)
        columns = [np.column_stack(numbers).astype(INT64), known]
        columns += [_by_axis(trial.mocap[part]), trial.valid[part].astype(np.bool_)]
        if truth is not None:
            columns.append(_by_axis(truth[part]))
        data = [np.ascontiguousarray(column).view(np.uint8) for column in columns]
        yield np.concatenate(data, axis=1).tobytes()


def _command(command: Command) -> bytes:
    return (
        pack("<q?", command.sent_ns, command.stops)
        + _flags(command.delivered)
        + _numbers(command.direction, command.left, command.right)
    )


def _step(step: Step) -> bytes:
    """Return a control step without its command, which is among the commands."""
    return pack("<q", step.k) + _observation(step.observation) + _plan(step.plan)


def _note(note: Note) -> bytes:
    return pack("<q", note.t_ns) + _text(note.level) + _text(printable(note.text, TEXT))


def _observation(seen: Observation) -> bytes:
    head = pack("<qqq", seen.frame, seen.sampled_ns, seen.received_ns)
    return head + _poses(seen.poses) + _flags(seen.valid)


def _poses(poses: Poses) -> bytes:
    return _bytes(poses.x) + _bytes(poses.y) + _bytes(poses.heading)


def _by_axis(poses: Floats) -> Floats:
    """Return poses (M, N, 3) as (M, 3 N): x of every robot, then y, then heading."""
    return poses.transpose(0, 2, 1).reshape(len(poses), -1).astype(FLOAT64)


def _plan(plan: Plan) -> bytes:
    """Return a plan; whether the field is off is part of the command."""
    costs = (plan.cost, plan.target_cost, plan.obstacle_cost)
    parts = [
        pack("<qqQ", len(plan.searches), plan.chosen, plan.generator),
        _numbers(*costs, plan.signals, plan.path, *_estimate(plan.estimate)),
    ]
    if plan.leg:
        parts.append(pack("<q", plan.leg))
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
