"""tetractl's own messages: from the records of a trial to protobuf and back, bit for bit."""

from collections.abc import Iterable

import numpy as np

from tetractl.core.commands import Command
from tetractl.core.plan import Estimate, Plan, Search, StopReason
from tetractl.core.poses import Floats, Observation, Poses
from tetractl.core.text import printable
from tetractl.core.trial import Step
from tetractl.log.format import tetractl_pb2 as pb

STOPPED = 60  # characters of why a search ended that are read back


def encode_observation(
    observation: Observation, into: pb.MocapSample | None = None
) -> pb.MocapSample:
    """Encode one camera frame; in a message that is there already, which takes half the time."""
    message, poses = into or pb.MocapSample(), observation.poses
    message.frame = observation.frame
    message.sampled_ns, message.received_ns = observation.sampled_ns, observation.received_ns
    _fill(message, poses)
    message.valid[:] = observation.valid.tolist()
    return message


def decode_observation(message: pb.MocapSample, robots: int | None = None) -> Observation:
    """Decode one camera frame; ValueError for another number of robots than `robots`."""
    if robots is not None and len(message.valid) != robots:
        raise ValueError(f"a frame of {len(message.valid)} robots, not {robots}")
    return Observation(
        frame=message.frame,
        sampled_ns=message.sampled_ns,
        received_ns=message.received_ns,
        poses=decode_poses(message, robots),
        valid=np.array(message.valid, dtype=np.bool_),
    )


def encode_truth(observation: Observation, truth: Poses, into: pb.Truth | None = None) -> pb.Truth:
    """Encode the true poses at a camera frame; as `encode_observation`."""
    message = into or pb.Truth()
    message.frame, message.sampled_ns = observation.frame, observation.sampled_ns
    _fill(message, truth)
    return message


def _fill(message: pb.MocapSample | pb.Truth, poses: Poses) -> None:
    message.x[:] = poses.x.tolist()
    message.y[:] = poses.y.tolist()
    message.heading[:] = poses.heading.tolist()


def decode_poses(message: pb.MocapSample | pb.Truth, robots: int | None = None) -> Poses:
    """Decode measured or true poses; ValueError for another number of robots than `robots`."""
    found = {len(message.x), len(message.y), len(message.heading)}
    if len(found) > 1 or (robots is not None and found != {robots}):
        raise ValueError(f"poses of {sorted(found)} robots, not {robots}")
    return Poses(_floats(message.x), _floats(message.y), _floats(message.heading))


def encode_command(command: Command) -> pb.WheelCommand:
    """Encode a command."""
    return pb.WheelCommand(
        direction=command.direction,
        stop=command.stops,
        sent_ns=command.sent_ns,
        delivered=command.delivered,
        left=None if command.left is None else command.left.tolist(),
        right=None if command.right is None else command.right.tolist(),
    )


def decode_command(message: pb.WheelCommand) -> Command:
    """Decode a command."""
    directed = message.HasField("direction")
    return Command(
        direction=message.direction if directed else None,
        sent_ns=message.sent_ns,
        delivered=tuple(message.delivered),
        left=_floats(message.left) if message.left else None,
        right=_floats(message.right) if message.right else None,
        field_off=not directed and not message.stop,
    )


def encode_step(step: Step) -> pb.ControllerStep:
    """Encode one control step without its time of solving, which has its own message."""
    plan = step.plan
    return pb.ControllerStep(
        k=step.k,
        observation=encode_observation(step.observation),
        command=encode_command(step.command),
        signals=plan.signals.tolist(),
        cost=plan.cost,
        target_cost=plan.target_cost,
        obstacle_cost=plan.obstacle_cost,
        searches=[_encode_search(search) for search in plan.searches],
        chosen=plan.chosen,
        generator=plan.generator,
        path_x=plan.path[..., 0].ravel().tolist(),
        path_y=plan.path[..., 1].ravel().tolist(),
        path_heading=plan.path[..., 2].ravel().tolist(),
    )


def decode_step(
    message: pb.ControllerStep,
    timing: pb.StepTiming | None,
    estimate: pb.Estimate | None = None,
    robots: int | None = None,
) -> Step:
    """Decode one control step; without its timing, solve_ns is 0.

    Raises ValueError for arrays of unequal lengths and for another number of robots than `robots`.
    """
    observation = decode_observation(message.observation, robots)
    robots = len(observation.poses.x)
    if not 0 <= message.chosen < len(message.searches) or not message.signals:
        raise ValueError(f"step {message.k} chooses a search that is not there")
    flat = [_floats(column) for column in (message.path_x, message.path_y, message.path_heading)]
    command = decode_command(message.command)
    plan = Plan(
        signals=_floats(message.signals),
        path=np.stack(flat, axis=-1).reshape(-1, robots, 3),
        cost=message.cost,
        target_cost=message.target_cost,
        obstacle_cost=message.obstacle_cost,
        searches=tuple(_decode_search(search) for search in message.searches),
        chosen=message.chosen,
        generator=message.generator,
        estimate=_decode_estimate(estimate, robots) if estimate else None,
        field_off=command.field_off,
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
    """Encode the time of solving of a control step."""
    return pb.StepTiming(k=step.k, solve_ns=step.solve_ns, deadline_missed=step.deadline_missed)


def encode_estimate(k: int, estimate: Estimate) -> pb.Estimate:
    """Encode the estimate of control step `k`."""
    bias, bias_std = estimate.heading_bias, estimate.heading_bias_std
    return pb.Estimate(
        k=k,
        a=estimate.a.tolist(),
        a_std=estimate.a_std.tolist(),
        speed=estimate.speed.tolist(),
        speed_std=estimate.speed_std.tolist(),
        heading_bias=None if bias is None else bias.tolist(),
        heading_bias_std=None if bias_std is None else bias_std.tolist(),
        dead_time=estimate.dead_time,
        dead_time_std=estimate.dead_time_std,
    )


def _decode_estimate(message: pb.Estimate, robots: int) -> Estimate:
    sure = (message.a, message.a_std, message.speed, message.speed_std)
    perhaps = (message.heading_bias, message.heading_bias_std)
    counts = {len(values) for values in (*sure, *filter(None, perhaps))}
    if counts != {robots}:
        raise ValueError(f"an estimate of {sorted(counts)} robots, not {robots}")
    bias, bias_std = (_floats(values) if values else None for values in perhaps)
    return Estimate(
        *map(_floats, sure),
        heading_bias=bias,
        heading_bias_std=bias_std,
        dead_time=message.dead_time if message.HasField("dead_time") else None,
        dead_time_std=message.dead_time_std if message.HasField("dead_time_std") else None,
    )


def _encode_search(search: Search) -> pb.Search:
    return pb.Search(
        length=search.length,
        signals=search.signals.tolist(),
        cost=search.cost,
        history=search.history.tolist(),
        evaluations=search.evaluations,
        stopped=search.stopped,
    )


def _decode_search(message: pb.Search) -> Search:
    return Search(
        length=message.length,
        signals=_floats(message.signals),
        cost=message.cost,
        history=_floats(message.history),
        evaluations=message.evaluations,
        stopped=StopReason.read(printable(message.stopped, STOPPED)),
    )


def _floats(values: Iterable[float]) -> Floats:
    return np.array(values, dtype=np.float64)
