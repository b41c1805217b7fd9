"""Convert the data of a trial, such as a camera frame, to messages of its log, and back.

    Observation <-> MocapSample      Step    <-> ControllerStep and StepTiming
    Command     <-> WheelCommand     Search, Estimate <-> messages of the same names
    Frames      <-> CameraFrames

Each pair is an `encode_` and a `decode_` function, next to each other. Decoding returns exactly the
bits that were encoded, with two exceptions, which only serve drawing: predicted paths are rounded
(`round_for_drawing`), and true poses have single precision unless they equal the measured ones.
Decoding raises ValueError for a message that cannot come from a trial with this number of robots.
"""

from collections.abc import Sequence

import numpy as np

from tetractl.core.commands import Action, Command, FieldOff, Steer, Stop, Turn
from tetractl.core.errors import printable
from tetractl.core.loggable import (
    LOGGED_ESTIMATE_FIELDS,
    STOP_REASON_MAX,
    round_for_drawing,
    stop_reason,
)
from tetractl.core.motion_estimate import Estimate
from tetractl.core.plan import Plan, Search, State
from tetractl.core.poses import Floats, Frames, Observation, Poses
from tetractl.core.trial import Step
from tetractl.log.format import tetractl_pb2 as pb
from tetractl.log.format.packed_columns import pack_columns, unpack_columns

FORMER_STATES = ("nearing", "leaving a corner")
"""States of earlier versions of tetractl, which are read as `driving`."""


# ---- Camera frames ----


@np.errstate(all="ignore")  # numbers beyond single precision
def encode_frames(frames: Frames) -> pb.CameraFrames:
    """Encode camera frames as a message of the log.

    True poses have single precision, unless they equal the measured ones.
    """
    frame_count = len(frames.numbers)
    late_ns = frames.sampled_ns[:, None] - frames.exposed_ns
    message = pb.CameraFrames(
        times=pack_columns(
            np.column_stack([frames.numbers, frames.sampled_ns, frames.received_ns])
        ),
        poses=pack_columns(frames.poses.reshape(frame_count, -1)),
        valid=frames.valid.ravel().tolist(),
    )
    if late_ns.any():
        message.late = pack_columns(late_ns)
    if frames.truth is None:
        message.exact = False
    elif frames.truth.tobytes() == frames.poses.tobytes():
        message.exact = True
    else:
        message.exact = False
        message.truth = pack_columns(frames.truth.reshape(frame_count, -1).astype(np.float32))
    return message


@np.errstate(all="ignore")  # any bits may be a number
def decode_frames(message: pb.CameraFrames, n_robots: int) -> Frames:
    """Decode the camera frames in a message of the log.

    Raises:
        ValueError: If the frames do not have `n_robots` robots.
    """
    times = unpack_columns(message.times, 3, "<i8")
    poses = unpack_columns(message.poses, 3 * n_robots, "<f8")
    truth = poses if message.exact else unpack_columns(message.truth, 3 * n_robots, "<f4")
    late_ns = unpack_columns(message.late, n_robots, "<i8")
    frame_count = len(times)
    has_required_arrays = len(poses) == frame_count and len(message.valid) == frame_count * n_robots
    has_optional_arrays = len(truth) in (0, frame_count) and len(late_ns) in (0, frame_count)
    if not has_required_arrays or not has_optional_arrays:
        raise ValueError(
            f"the arrays of camera frames must have an entry for each of {frame_count} frames "
            f"and {n_robots} robots"
        )
    sampled_ns = times[:, 1]
    exposed_ns = np.repeat(sampled_ns[:, None], n_robots, axis=1)
    if len(late_ns):
        exposed_ns = exposed_ns - late_ns
    true_poses = None
    if len(truth) == frame_count:
        true_poses = truth.astype(np.float64).reshape(frame_count, n_robots, 3)
    return Frames(
        numbers=times[:, 0],
        sampled_ns=sampled_ns,
        received_ns=times[:, 2],
        poses=poses.reshape(frame_count, n_robots, 3),
        valid=np.array(message.valid, dtype=np.bool_).reshape(frame_count, n_robots),
        truth=true_poses,
        exposed_ns=exposed_ns,
    )


# ---- Control steps ----


def encode_observation(observation: Observation) -> pb.MocapSample:
    """Encode the camera frame on which the controller decided in a control step."""
    return pb.MocapSample(
        frame=observation.frame,
        sampled_ns=observation.sampled_ns,
        received_ns=observation.received_ns,
        x=observation.poses.x.tolist(),
        y=observation.poses.y.tolist(),
        heading=observation.poses.heading.tolist(),
        valid=observation.valid.tolist(),
        exposed_ns=observation.exposed_ns,
    )


def decode_observation(message: pb.MocapSample, n_robots: int) -> Observation:
    """Decode the camera frame on which the controller based a decision.

    Raises:
        ValueError: If the frame does not have `n_robots` robots.
    """
    counts = {len(column) for column in (message.x, message.y, message.heading, message.valid)}
    if counts != {n_robots} or len(message.exposed_ns) not in (0, n_robots):
        raise ValueError(f"a frame has {sorted(counts)} robots instead of {n_robots}")
    columns = map(_floats, (message.x, message.y, message.heading))
    return Observation(
        frame=message.frame,
        sampled_ns=message.sampled_ns,
        received_ns=message.received_ns,
        poses=Poses(*columns),
        valid=np.array(message.valid, dtype=np.bool_),
        exposed_ns=tuple(message.exposed_ns),
    )


def encode_command(command: Command) -> pb.WheelCommand:
    """Encode a command to the robots as a message of the log."""
    return pb.WheelCommand(
        stop=command.stops,
        direction=command.direction,
        lag=command.action.lag_s if isinstance(command.action, Steer) else None,
        facing=command.action.facing if isinstance(command.action, Turn) else None,
        sent_ns=command.sent_ns,
        delivered=command.delivered,
        left=_listed(command.left),
        right=_listed(command.right),
    )


def decode_command(message: pb.WheelCommand) -> Command:
    """Decode a command to the robots from a message of the log.

    Wheel speeds are None if the message has none.
    """
    return Command(
        _decode_action(message),
        sent_ns=message.sent_ns,
        delivered=tuple(message.delivered),
        left=_floats(message.left) if message.left else None,
        right=_floats(message.right) if message.right else None,
    )


def _decode_action(message: pb.WheelCommand) -> Action:
    if message.HasField("direction"):
        return Steer(message.direction, message.lag if message.HasField("lag") else None)
    if message.HasField("facing"):
        return Turn(message.facing)
    return Stop() if message.stop else FieldOff()


def encode_step(step: Step, command: pb.WheelCommand) -> pb.ControllerStep:
    """Encode one control step with its encoded command.

    The solve time is not included, because it differs from run to run. Predicted paths are
    rounded, and lose their headings.
    """
    plan = step.plan
    path = round_for_drawing(plan.path[..., :2]).reshape(-1, 2)
    return pb.ControllerStep(
        k=step.k,
        observation=encode_observation(step.observation),
        command=command,
        signals=plan.signals.tolist(),
        cost=plan.cost,
        target_cost=plan.target_cost,
        obstacle_cost=plan.obstacle_cost,
        searches=[
            pb.Search(
                length=search.length,
                signals=search.signals.tolist(),
                cost=search.cost,
                history=search.history.tolist(),
                evaluations=search.evaluations,
                stopped=printable(search.stopped, STOP_REASON_MAX),
            )
            for search in plan.searches
        ],
        chosen=plan.chosen,
        generator=plan.generator,
        path_x=path[:, 0].tolist(),
        path_y=path[:, 1].tolist(),
        leg=plan.leg,
        delay_ns=plan.delay_ns,
        state=plan.state,
        estimate=_encode_estimate(plan.estimate) if plan.estimate else None,
        numbers=[pb.Number(name=name, value=value) for name, value in plan.numbers.items()],
    )


def decode_step(message: pb.ControllerStep, timing: pb.StepTiming | None, n_robots: int) -> Step:
    """Decode one control step.

    The headings of the planned path are not logged, so they become NaN.

    Args:
        message: The message of the step.
        timing: The message with the step's solve time. If it is None, `solve_ns` is 0.
        n_robots: Number of robots.

    Raises:
        ValueError: If arrays have unequal lengths, or the number of robots differs.
    """
    observation = decode_observation(message.observation, n_robots)
    if not message.signals:
        raise ValueError(f"step {message.k} has no signal")
    if not 0 <= message.chosen < len(message.searches):
        count = len(message.searches)
        raise ValueError(
            f"step {message.k} refers to its search {message.chosen}, but the step has"
            f" only {count} searches"
        )
    command = decode_command(message.command)
    x = _floats(message.path_x)
    y = _floats(message.path_y)
    path = np.stack([x, y, np.full_like(x, np.nan)], axis=-1)
    plan = Plan(
        signals=_floats(message.signals),
        path=path.reshape(-1, n_robots, 3),
        cost=message.cost,
        target_cost=message.target_cost,
        obstacle_cost=message.obstacle_cost,
        searches=tuple(
            Search(
                length=search.length,
                signals=_floats(search.signals),
                cost=search.cost,
                history=_floats(search.history),
                evaluations=search.evaluations,
                stopped=stop_reason(search.stopped),
            )
            for search in message.searches
        ),
        chosen=message.chosen,
        generator=message.generator,
        estimate=_decode_estimate(message.estimate, n_robots)
        if message.HasField("estimate")
        else None,
        instead=None if isinstance(command.action, Steer) else command.action,
        state=State.DRIVING if message.state in FORMER_STATES else State(message.state),
        leg=message.leg,
        delay_ns=message.delay_ns,
        numbers={number.name: number.value for number in message.numbers},
    )
    return Step(
        k=message.k,
        observation=observation,
        plan=plan,
        command=command,
        solve_ns=timing.solve_ns if timing else 0,
        deadline_missed=timing.deadline_missed if timing else False,
    )


def _encode_estimate(estimate: Estimate) -> pb.Estimate:
    """Encode the controller's estimate of the motion. Missing values stay unset."""
    misfit = None if estimate.misfit is None else estimate.misfit.ravel().tolist()
    return pb.Estimate(
        a=estimate.a.tolist(),
        a_std=estimate.a_std.tolist(),
        speed=estimate.speed.tolist(),
        speed_std=estimate.speed_std.tolist(),
        heading_bias=_listed(estimate.heading_bias),
        heading_bias_std=_listed(estimate.heading_bias_std),
        dead_time=estimate.dead_time,
        dead_time_std=estimate.dead_time_std,
        misfit=misfit,
        side=_listed(estimate.side),
        side_std=_listed(estimate.side_std),
        saturation=_listed(estimate.saturation),
        stands=_listed(estimate.stands),
        lag=_listed(estimate.lag),
        lag_std=_listed(estimate.lag_std),
    )


def _decode_estimate(message: pb.Estimate, n_robots: int) -> Estimate:
    """Decode an estimate of the motion.

    Raises ValueError unless each of its arrays has an entry for each of `n_robots` robots.
    """
    estimate = Estimate(
        a=_floats(message.a),
        a_std=_floats(message.a_std),
        speed=_floats(message.speed),
        speed_std=_floats(message.speed_std),
        heading_bias=_floats_or_none(message.heading_bias),
        heading_bias_std=_floats_or_none(message.heading_bias_std),
        dead_time=message.dead_time if message.HasField("dead_time") else None,
        dead_time_std=message.dead_time_std if message.HasField("dead_time_std") else None,
        misfit=_floats(message.misfit).reshape(-1, 3) if message.misfit else None,
        side=_floats_or_none(message.side),
        side_std=_floats_or_none(message.side_std),
        saturation=_floats_or_none(message.saturation),
        stands=_floats_or_none(message.stands),
        lag=_floats_or_none(message.lag),
        lag_std=_floats_or_none(message.lag_std),
    )
    values = (getattr(estimate, name) for name in LOGGED_ESTIMATE_FIELDS)
    counts = {len(value) for value in values if isinstance(value, np.ndarray)}
    if counts != {n_robots}:
        raise ValueError(f"an estimate has {sorted(counts)} robots instead of {n_robots}")
    return estimate


# ---- Arrays ----


def _floats(values: Sequence[float]) -> Floats:
    return np.array(values[:], dtype=np.float64)  # as a list, since protobuf's sequences are slow


def _floats_or_none(values: Sequence[float]) -> Floats | None:
    """Convert optional numbers to an array, or to None if there are no numbers.

    A message cannot distinguish an empty array from a missing array.
    """
    return _floats(values) if values else None


def _listed(values: Floats | None) -> list[float] | None:
    return None if values is None else values.tolist()
