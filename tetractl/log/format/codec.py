"""Converts the records of a trial to tetractl's protobuf messages and back, bit for bit."""

from collections.abc import Sequence
from functools import lru_cache
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from google.protobuf.message import Message
from numpy.typing import NDArray

from tetractl.core.commands import Action, Command, FieldOff, Sample, Steer, Stop, Turn
from tetractl.core.errors import printable
from tetractl.core.plan import Estimate, Plan, Search, State, StopReason
from tetractl.core.poses import Bools, Floats, Integers, Observation, Poses
from tetractl.core.trial import Step
from tetractl.log.format import tetractl_pb2 as pb

OF_ESTIMATE = tuple(pb.Estimate.DESCRIPTOR.fields_by_name)
OF_PLAN = ("cost", "target_cost", "obstacle_cost", "chosen", "generator", "leg", "delay_ns")
"""The numbers of a plan that are fields of `ControllerStep`."""
FORMER_STATES = ("nearing", "leaving a corner")
"""States of earlier versions, in which robots followed signals; they are read as `driving`."""
STOP_REASON_MAX = 60  # largest number of characters read of the reason why a search stopped
DIFFERENCES = 4  # how often a packed column is replaced by its differences
DRAWN_PRECISION = 2.0**-14  # largest relative rounding error of `drawn`

_reader = lru_cache(attrgetter)  # `named` is called for each step: its getters are made once


class Frames(NamedTuple):
    """M camera frames of N robots, stored as arrays.

    `numbers`, `sampled_ns` and `received_ns` are (M,), `poses` and `truth` (M, N, 3) and `valid`
    (M, N); `truth` is None if no true poses are known. `exposed_ns` (M, N) are the times of the
    poses, by default those of their frames.
    """

    numbers: Integers
    sampled_ns: Integers
    received_ns: Integers
    poses: Floats
    valid: Bools
    truth: Floats | None
    exposed_ns: Integers

    @classmethod
    def of(cls, samples: Sequence[Sample], robots: int) -> "Frames":
        """Return samples as arrays; `truth` is None unless every sample has true poses."""
        seen = [sample.observation for sample in samples]
        times = [(one.frame, one.sampled_ns, one.received_ns) for one in seen]
        truth = [sample.truth for sample in samples if sample.truth is not None]
        numbers, sampled_ns, received_ns = np.array(times, dtype=np.int64).reshape(-1, 3).T
        poses = _columns([one.poses for one in seen], robots)
        valid = np.array([one.valid for one in seen], dtype=np.bool_).reshape(-1, robots)
        known = _columns(truth, robots) if len(truth) == len(seen) else None
        own = [one.exposed_ns or (one.sampled_ns,) * robots for one in seen]
        exposed_ns = np.array(own, dtype=np.int64).reshape(-1, robots)
        return cls(numbers, sampled_ns, received_ns, poses, valid, known, exposed_ns)

    @classmethod
    def joined(cls, parts: Sequence["Frames"]) -> "Frames":
        """Join parts in order; `truth` is None unless every part has true poses."""
        columns: list[Any] = [
            None if any(one is None for one in arrays) else np.concatenate(arrays)
            for arrays in zip(*parts, strict=True)
        ]
        return cls(*columns)

    def part(self, rows: slice | Integers) -> "Frames":
        """Return the frames in the given rows."""
        columns: list[Any] = [None if one is None else one[rows] for one in self]
        return Frames(*columns)


def _columns(poses: Sequence[Poses], robots: int) -> Floats:
    """Stack the poses of N robots at M times in an array (M, N, 3)."""
    rows = [column for one in poses for column in (one.x, one.y, one.heading)]
    return np.concatenate([[], *rows]).reshape(-1, 3, robots).transpose(0, 2, 1)


@np.errstate(all="ignore")  # numbers beyond single precision
def drawn(values: Floats) -> Floats:
    """Round numbers that are only drawn to 14 significant bits: zeros take no space in a log."""
    bits = values.astype(np.float32).view(np.int32)
    return ((bits + (1 << 9)) & -(1 << 10)).view(np.float32).astype(np.float64)


def packed(columns: NDArray[Any]) -> bytes:
    """Pack columns (M, C) of numbers of 4 or 8 bytes as `CameraFrames` defines."""
    size, (count, width) = columns.itemsize, columns.shape
    steps = np.ascontiguousarray(columns).view(f"<i{size}")
    if count > 1:
        zeros = np.zeros((DIFFERENCES, width), steps.dtype)
        steps = np.diff(np.concatenate([zeros, steps]), DIFFERENCES, axis=0)
    zigzag = (steps << 1) ^ (steps >> (8 * size - 1))
    return np.ascontiguousarray(zigzag.T).view(np.uint8).reshape(-1, size).T.tobytes()


def unpacked(data: bytes, width: int, kind: str) -> NDArray[Any]:
    """Return the columns (M, `width`) of numbers of type `kind` in packed bytes; ValueError for
    another number of bytes."""
    size = np.dtype(kind).itemsize
    if not data:
        return np.zeros((0, width), kind)
    planes = np.frombuffer(data, np.uint8).reshape(size, width, -1).transpose(2, 1, 0)
    zigzag = np.ascontiguousarray(planes).view(f"<u{size}")[..., 0]
    found = (zigzag >> 1) ^ -(zigzag & 1)
    for _ in range(DIFFERENCES if len(found) > 1 else 0):
        found = np.cumsum(found, axis=0, dtype=found.dtype)
    return found.view(kind)


@np.errstate(all="ignore")  # numbers beyond single precision
def encode_frames(frames: Frames) -> pb.CameraFrames:
    """Encode camera frames; true poses have single precision unless they are the measured ones."""
    count, truth = len(frames.numbers), frames.truth
    exact = truth is not None and truth.tobytes() == frames.poses.tobytes()
    single = None if exact or truth is None else truth.reshape(count, -1).astype(np.float32)
    late = frames.sampled_ns[:, None] - frames.exposed_ns
    return pb.CameraFrames(
        late=packed(late) if late.any() else None,
        times=packed(np.column_stack([frames.numbers, frames.sampled_ns, frames.received_ns])),
        poses=packed(frames.poses.reshape(count, -1)),
        valid=frames.valid.ravel().tolist(),
        truth=None if single is None else packed(single),
        exact=exact,
    )


@np.errstate(all="ignore")  # any bits may be a number
def decode_frames(message: pb.CameraFrames, robots: int) -> Frames:
    """Decode camera frames; ValueError for another number of robots than `robots`."""
    times, poses = unpacked(message.times, 3, "<i8"), unpacked(message.poses, 3 * robots, "<f8")
    truth = poses if message.exact else unpacked(message.truth, 3 * robots, "<f4")
    late = unpacked(message.late, robots, "<i8")
    count, (numbers, sampled_ns, received_ns) = len(times), times.T
    known = len(truth) in (0, count) and len(late) in (0, count)
    if len(poses) != count or len(message.valid) != count * robots or not known:
        raise ValueError(f"arrays of camera frames do not have {count} times {robots} entries")
    return Frames(
        numbers,
        sampled_ns,
        received_ns,
        poses.reshape(count, robots, 3),
        np.array(message.valid, dtype=np.bool_).reshape(count, robots),
        truth.astype(np.float64).reshape(count, robots, 3) if len(truth) == count else None,
        np.repeat(sampled_ns[:, None], robots, axis=1) - (late if len(late) else 0),
    )


def named(record: object, *names: str) -> dict[str, Any]:
    """Return the named fields of a record as arguments of a message; None leaves a field unset."""
    values = _reader(*names)(record)
    return {
        name: value.ravel().tolist() if isinstance(value, np.ndarray) else value
        for name, value in zip(names, values, strict=True)
    }


def stated(message: Message, *names: str) -> dict[str, Any]:
    """Return the named fields of a message as arguments of a record, repeated ones as tuples."""
    found = {name: getattr(message, name) for name in names}
    return {k: v if isinstance(v, int | float | str) else tuple(v) for k, v in found.items()}


def encode_observation(observation: Observation) -> pb.MocapSample:
    """Encode the camera frame on which a control step is decided."""
    return pb.MocapSample(
        **named(observation, "frame", "sampled_ns", "received_ns", "valid", "exposed_ns"),
        **named(observation.poses, "x", "y", "heading"),
    )


def decode_observation(message: pb.MocapSample, robots: int) -> Observation:
    """Decode one camera frame; ValueError for another number of robots than `robots`."""
    found = {len(column) for column in (message.x, message.y, message.heading, message.valid)}
    if found != {robots} or len(message.exposed_ns) not in (0, robots):
        raise ValueError(f"a frame has {sorted(found)} robots instead of {robots}")
    return Observation(
        frame=message.frame,
        sampled_ns=message.sampled_ns,
        received_ns=message.received_ns,
        poses=Poses(_floats(message.x), _floats(message.y), _floats(message.heading)),
        valid=np.array(message.valid, dtype=np.bool_),
        exposed_ns=tuple(message.exposed_ns),
    )


def encode_command(command: Command) -> pb.WheelCommand:
    """Encode a command."""
    facing = command.action.facing if isinstance(command.action, Turn) else None
    fields = named(command, "direction", "sent_ns", "delivered", "left", "right")
    return pb.WheelCommand(stop=command.stops, facing=facing, **fields)


def decode_command(message: pb.WheelCommand) -> Command:
    """Decode a command."""
    action: Action = Stop() if message.stop else FieldOff()
    if message.HasField("direction"):
        action = Steer(message.direction)
    elif message.HasField("facing"):
        action = Turn(message.facing)
    return Command(
        action,
        sent_ns=message.sent_ns,
        delivered=tuple(message.delivered),
        left=_floats(left) if (left := message.left) else None,
        right=_floats(right) if (right := message.right) else None,
    )


def encode_step(step: Step, command: pb.WheelCommand) -> pb.ControllerStep:
    """Encode one control step with its encoded command; its solve time is in a separate message."""
    plan = step.plan
    x, y = drawn(plan.path[..., :2]).reshape(-1, 2).T.tolist()
    return pb.ControllerStep(
        k=step.k,
        observation=encode_observation(step.observation),
        command=command,
        searches=[_encode_search(search) for search in plan.searches],
        path_x=x,
        path_y=y,
        estimate=pb.Estimate(**named(plan.estimate, *OF_ESTIMATE)) if plan.estimate else None,
        **named(plan, "signals", "state", *OF_PLAN),
    )


def decode_step(message: pb.ControllerStep, timing: pb.StepTiming | None, robots: int) -> Step:
    """Decode one control step; without its timing, solve_ns is 0. The headings of its path, which
    are not logged, are NaN.

    Raises ValueError for arrays of unequal lengths and for another number of robots than `robots`.
    """
    observation = decode_observation(message.observation, robots)
    if not 0 <= message.chosen < len(message.searches) or not message.signals:
        raise ValueError(f"step {message.k} chooses a search that does not exist")
    x, y = _floats(message.path_x), _floats(message.path_y)
    command = decode_command(message.command)
    plan = Plan(
        signals=_floats(message.signals),
        path=np.stack([x, y, np.full_like(x, np.nan)], axis=-1).reshape(-1, robots, 3),
        searches=tuple(_decode_search(search) for search in message.searches),
        estimate=_decode_estimate(message, robots),
        instead=None if isinstance(command.action, Steer) else command.action,
        state=_decode_state(message.state),
        **stated(message, *OF_PLAN),
    )
    return Step(
        k=message.k,
        observation=observation,
        plan=plan,
        command=command,
        solve_ns=timing.solve_ns if timing else 0,
        deadline_missed=bool(timing and timing.deadline_missed),
    )


def _decode_state(text: str) -> State:
    """Decode what the robots do; one of FORMER_STATES is `driving`."""
    return State.DRIVING if text in FORMER_STATES else State(text)


def encode_timing(step: Step) -> pb.StepTiming:
    """Encode the solve time of a control step."""
    return pb.StepTiming(**named(step, "k", "solve_ns", "deadline_missed"))


def _decode_estimate(step: pb.ControllerStep, robots: int) -> Estimate | None:
    if not step.HasField("estimate"):
        return None
    found: dict[str, Any] = {
        field.name: value if isinstance(value, float) else _floats(value)
        for field, value in step.estimate.ListFields()
    }
    if "misfit" in found:
        found["misfit"] = found["misfit"].reshape(-1, 3)
    needed = (found.get(name, np.empty(0)) for name in OF_ESTIMATE[:4])
    every = (*needed, *(value for value in found.values() if isinstance(value, np.ndarray)))
    if (counts := {len(values) for values in every}) != {robots}:
        raise ValueError(f"an estimate has {sorted(counts)} robots instead of {robots}")
    return Estimate(**found)


def _encode_search(search: Search) -> pb.Search:
    fields = named(search, "length", "signals", "cost", "history", "evaluations")
    return pb.Search(stopped=printable(search.stopped, STOP_REASON_MAX), **fields)


def _decode_search(message: pb.Search) -> Search:
    return Search(
        length=message.length,
        signals=_floats(message.signals),
        cost=message.cost,
        history=_floats(message.history),
        evaluations=message.evaluations,
        stopped=StopReason.read(printable(message.stopped, STOP_REASON_MAX)),
    )


def _floats(values: Sequence[float]) -> Floats:
    return np.array(values[:], dtype=np.float64)  # as a list, since protobuf's sequences are slow
