"""Converts the records of a trial to tetractl's protobuf messages and back, bit for bit."""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from google.protobuf.message import Message

from tetractl.core.commands import Action, Command, FieldOff, Sample, Steer, Stop, Turn
from tetractl.core.errors import printable
from tetractl.core.plan import Estimate, Plan, Search, State, StopReason
from tetractl.core.poses import Bools, Floats, Observation, Poses
from tetractl.core.trial import Integers, Step
from tetractl.log.format import tetractl_pb2 as pb

OF_PLAN = ("cost", "target_cost", "obstacle_cost", "chosen", "generator", "leg", "delay_ns")
"""The numbers of a plan that are fields of `ControllerStep`."""
STOP_REASON_MAX = 60  # largest number of characters read of the reason why a search stopped


class Frames(NamedTuple):
    """M camera frames of N robots, stored as arrays.

    `numbers`, `sampled_ns` and `received_ns` are (M,), `poses` and `truth` (M, N, 3) and `valid`
    (M, N); `truth` is None if no true poses are known.
    """

    numbers: Integers
    sampled_ns: Integers
    received_ns: Integers
    poses: Floats
    valid: Bools
    truth: Floats | None

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
        return cls(numbers, sampled_ns, received_ns, poses, valid, known)

    @classmethod
    def joined(cls, parts: Sequence["Frames"]) -> "Frames":
        """Join parts in order; if only some parts have true poses, those of the others are NaN."""
        known = [one.truth for one in parts if one.truth is not None]
        if 0 < len(known) < len(parts):
            lost = [np.full_like(one.poses, np.nan) for one in parts]
            pairs = zip(parts, lost, strict=True)
            known = [nan if one.truth is None else one.truth for one, nan in pairs]
        columns: list[Any] = [
            np.concatenate(arrays) for arrays in zip(*(one[:-1] for one in parts), strict=True)
        ]
        return cls(*columns, truth=np.concatenate(known) if known else None)

    def part(self, rows: slice | Integers) -> "Frames":
        """Return the frames in the given rows."""
        columns: list[Any] = [None if one is None else one[rows] for one in self]
        return Frames(*columns)


def _columns(poses: Sequence[Poses], robots: int) -> Floats:
    """Stack the poses of N robots at M times in an array (M, N, 3)."""
    rows = [(one.x, one.y, one.heading) for one in poses]
    return np.array(rows, dtype=np.float64).reshape(-1, 3, robots).transpose(0, 2, 1)


def encode_frames(frames: Frames) -> pb.CameraFrames:
    """Encode camera frames."""
    x, y, heading = frames.poses.reshape(-1, 3).T.tolist()
    message = pb.CameraFrames(
        frame=frames.numbers.tolist(),
        sampled_ns=frames.sampled_ns.tolist(),
        received_ns=frames.received_ns.tolist(),
        x=x,
        y=y,
        heading=heading,
        valid=frames.valid.ravel().tolist(),
    )
    if frames.truth is not None:
        columns = frames.truth.reshape(-1, 3).T.tolist()
        message.true_x[:], message.true_y[:], message.true_heading[:] = columns
    return message


def decode_frames(message: pb.CameraFrames, robots: int) -> Frames:
    """Decode camera frames; ValueError for another number of robots than `robots`."""
    m = message
    measured, true = (m.x, m.y, m.heading), (m.true_x, m.true_y, m.true_heading)
    count = len(m.frame)
    sizes = {len(column) for column in (*measured, m.valid)}
    times = {len(m.sampled_ns), len(m.received_ns)}
    known = {len(column) for column in true}
    if times != {count} or sizes != {count * robots} or known not in ({0}, sizes):
        raise ValueError(f"arrays of camera frames do not have {count} times {robots} entries")
    poses, truth = (
        np.array(part, dtype=np.float64).T.reshape(-1, robots, 3) for part in (measured, true)
    )
    return Frames(
        np.array(m.frame, dtype=np.int64),
        np.array(m.sampled_ns, dtype=np.int64),
        np.array(m.received_ns, dtype=np.int64),
        poses,
        np.array(m.valid, dtype=np.bool_).reshape(count, robots),
        truth if len(truth) == count else None,
    )


def named(record: object, *names: str) -> dict[str, Any]:
    """Return the named fields of a record as arguments of a message; None leaves a field unset."""
    found = ((name, getattr(record, name)) for name in names)
    return {k: value.tolist() if isinstance(value, np.ndarray) else value for k, value in found}


def stated(message: Message, *names: str) -> dict[str, Any]:
    """Return the named fields of a message as arguments of a record, repeated ones as tuples."""
    found = {name: getattr(message, name) for name in names}
    return {k: v if isinstance(v, int | float | str) else tuple(v) for k, v in found.items()}


def encode_observation(observation: Observation) -> pb.MocapSample:
    """Encode the camera frame on which a control step is decided."""
    return pb.MocapSample(
        **named(observation, "frame", "sampled_ns", "received_ns", "valid"),
        **named(observation.poses, "x", "y", "heading"),
    )


def decode_observation(message: pb.MocapSample, robots: int) -> Observation:
    """Decode one camera frame; ValueError for another number of robots than `robots`."""
    found = {len(column) for column in (message.x, message.y, message.heading, message.valid)}
    if found != {robots}:
        raise ValueError(f"a frame has {sorted(found)} robots instead of {robots}")
    return Observation(
        frame=message.frame,
        sampled_ns=message.sampled_ns,
        received_ns=message.received_ns,
        poses=Poses(_floats(message.x), _floats(message.y), _floats(message.heading)),
        valid=np.array(message.valid, dtype=np.bool_),
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
        left=_floats(message.left) if message.left else None,
        right=_floats(message.right) if message.right else None,
    )


def encode_step(step: Step) -> pb.ControllerStep:
    """Encode one control step; its solve time is in a separate message."""
    plan = step.plan
    x, y, heading = plan.path.reshape(-1, 3).T.tolist()
    return pb.ControllerStep(
        k=step.k,
        observation=encode_observation(step.observation),
        command=encode_command(step.command),
        searches=[_encode_search(search) for search in plan.searches],
        path_x=x,
        path_y=y,
        path_heading=heading,
        **named(plan, "signals", "state", *OF_PLAN),
    )


def decode_step(
    message: pb.ControllerStep,
    timing: pb.StepTiming | None,
    estimate: pb.Estimate | None,
    robots: int,
) -> Step:
    """Decode one control step; without its timing, solve_ns is 0.

    Raises ValueError for arrays of unequal lengths and for another number of robots than `robots`.
    """
    observation = decode_observation(message.observation, robots)
    if not 0 <= message.chosen < len(message.searches) or not message.signals:
        raise ValueError(f"step {message.k} chooses a search that does not exist")
    flat = [_floats(column) for column in (message.path_x, message.path_y, message.path_heading)]
    command = decode_command(message.command)
    plan = Plan(
        signals=_floats(message.signals),
        path=np.stack(flat, axis=-1).reshape(-1, robots, 3),
        searches=tuple(_decode_search(search) for search in message.searches),
        estimate=_decode_estimate(estimate, robots) if estimate else None,
        instead=None if isinstance(command.action, Steer) else command.action,
        state=State(message.state),
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


def encode_timing(step: Step) -> pb.StepTiming:
    """Encode the solve time of a control step."""
    return pb.StepTiming(**named(step, "k", "solve_ns", "deadline_missed"))


def encode_estimate(k: int, estimate: Estimate) -> pb.Estimate:
    """Encode the estimate of control step `k`."""
    each = (
        named(estimate, name, f"{name}_std") for name in ("a", "speed", "heading_bias", "dead_time")
    )
    misfit = [] if estimate.misfit is None else estimate.misfit.ravel()
    return pb.Estimate(k=k, misfit=misfit, **{key: v for two in each for key, v in two.items()})


def _decode_estimate(message: pb.Estimate, robots: int) -> Estimate:
    found: dict[str, Any] = {
        field.name: value if isinstance(value, float) else _floats(value)
        for field, value in message.ListFields()
        if field.name != "k"
    }
    misfit = found.pop("misfit", np.empty(0))
    arrays = (found.get(name, np.empty(0)) for name in ("a", "a_std", "speed", "speed_std"))
    every = (*arrays, *(value for value in found.values() if isinstance(value, np.ndarray)))
    counts = {len(values) for values in every}
    if counts != {robots}:
        raise ValueError(f"an estimate has {sorted(counts)} robots instead of {robots}")
    if len(misfit) not in (0, 3 * robots):
        raise ValueError(f"an estimate has {len(misfit)} values of misfit")
    return Estimate(**found, misfit=misfit.reshape(-1, 3) if len(misfit) else None)


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


def _floats(values: Iterable[float]) -> Floats:
    return np.array(values, dtype=np.float64)
