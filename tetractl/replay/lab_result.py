"""Computes again what tables use of a lab's log, from its frames and commands: errors, final
poses, distances to obstacles, duration, and how fast the robots turned by themselves.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from tetractl.core.clock import SECOND, seconds
from tetractl.core.commands import HALTS, Command, Verdict
from tetractl.core.poses import CameraFrame, Pose, Poses
from tetractl.core.trial import Result
from tetractl.experiment.lab_section import LabSection
from tetractl.lab.guard import Guard
from tetractl.lab.guard_records import GuardState
from tetractl.lab.rig import guard_rules
from tetractl.log.read.reader import trial_path
from tetractl.log.read.trial_log import TrialLog
from tetractl.model.path_check import check_path, tracked_separations
from tetractl.model.wheels import body_velocity
from tetractl.replay.comparison import Difference, first_difference

DISTANCE_TOLERANCE = 1e-6
"""Tolerance of a least distance, relative."""
STOP_REPEATED_NS = 500_000_000
"""Longest time from a stop's first repetition to its last [ns]."""
LAST_FRAMES = 120
"""A lab trial's final poses must be those of one of this many last frames: once, logs had some
more."""


def lab_differences(log: TrialLog, result: Result) -> Iterator[Difference]:
    """Yield what in the result of an undamaged log its frames and commands contradict."""
    if log.stop is None:
        return
    yield from _lasted(log, result, log.stop)
    yield from error_differences(log, result)
    if result.outcome.complete or not untold(result.verdict):
        if not _stands(log, result.verdict.final, log.stop):
            yield Difference(None, "result.final", "differs from the robots' last poses")
        yield from _obstacles(log, result.verdict, log.stop)
    if result.outcome.complete:  # no log says when the guard of another aborted it
        yield from _turns(log, result.verdict)


def untold(verdict: Verdict) -> bool:
    """Return whether a verdict states nothing, as `Verdict.unknown`."""
    if any(verdict.entered) or np.isfinite(verdict.clearance).any():
        return False
    final = verdict.final.array()
    return bool(np.isnan(final).all())


def error_differences(log: TrialLog, result: Result) -> Iterator[Difference]:
    """Yield the first value of a result that contradicts its final poses or its tour."""
    again = Result.of(
        log.start.setup,
        result.verdict,
        outcome=result.outcome,
        reason=result.reason,
        duration_s=result.duration_s,
        solve_ns=tuple(step.solve_ns for step in log.steps),
        deadline_misses=result.deadline_misses,
        tour=log.tour,
    )
    difference = first_difference(again, result, name="result")
    if difference is not None:
        yield difference


def _obstacles(log: TrialLog, verdict: Verdict, stop: Command) -> Iterator[Difference]:
    """Check the distances and the entered obstacles in the verdict against the logged path.

    The plant of a lab evaluates only the frames between the first step and the stop. A stated
    distance must therefore lie between the least distance in all frames and the least distance in
    the evaluated frames. A pose that came so late that its robot no longer counts as tracked is a
    place where the robot was, too, but not one at which others were at the time of its frame.
    """
    path, has_pose = trial_path(log)
    has_place = np.asarray(np.isfinite(path).all(axis=2))
    in_all = check_path(log.start.setup, path, has_place, verdict.final)
    apart = tracked_separations(path, has_pose)
    since = log.steps[0].command.sent_ns if log.steps else stop.sent_ns
    driven = (log.received_ns > since) & (log.received_ns <= stop.sent_ns)
    evaluated = check_path(log.start.setup, path[driven], has_pose[driven], verdict.final)
    for name, stated, least, most in (
        ("clearance", verdict.clearance, in_all.clearance, evaluated.clearance),
        ("edge", verdict.edge, in_all.edge, evaluated.edge),
        ("apart", verdict.apart, apart.tolist(), evaluated.apart),
    ):
        yield from _distances(name, stated, least, most)
    for i, (stated, touches) in enumerate(zip(verdict.entered, in_all.entered, strict=True)):
        if stated != touches:
            text = f"states {stated}, but the logged path gives {touches}"
            yield Difference(None, f"result.entered.{i}", text)


def _distances(
    name: str, stated: Sequence[float], least: Sequence[float], most: Sequence[float]
) -> Iterator[Difference]:
    """Check that each stated distance is within its least and its greatest possible value."""
    for i, (distance, low, high) in enumerate(zip(stated, least, most, strict=False)):
        floor = low - DISTANCE_TOLERANCE * max(1.0, abs(low)) if np.isfinite(low) else -np.inf
        ceiling = high + DISTANCE_TOLERANCE * max(1.0, abs(high))
        if not floor <= distance <= ceiling:
            text = f"states {distance}, the frames show {low} to {high}"
            yield Difference(None, f"result.{name}.{i}", text)


def _lasted(log: TrialLog, result: Result, stop: Command) -> Iterator[Difference]:
    """Check the duration of a trial in the lab, from the first direction to the stop; without a
    direction, it counts from the opening of the devices, within a second of the first frame.
    """
    directed = [command.sent_ns for command in log.commands if not command.stops]
    opened = int(log.received_ns[0]) - SECOND if len(log.received_ns) else 0
    least = seconds(stop.sent_ns - min(directed, default=stop.sent_ns))
    most = least if directed else seconds(stop.sent_ns - opened)
    if not least <= result.duration_s <= most:
        text = f"states {result.duration_s} s, but the commands give {least} to {most} s"
        yield Difference(None, "result.duration_s", text)


def _stands(log: TrialLog, final: Poses, stop: Command) -> bool:
    """Return whether the final poses are those of one of the last frames or, for robots that swim
    on after the stop, of any frame since STOP_REPEATED_NS before the stop, or since the last one
    before it if the pictures ended earlier.
    """
    if not len(log.mocap):
        return True
    rows = log.mocap[-LAST_FRAMES:]
    if log.start.plant.facts.get(HALTS) == "no":
        before_stop = log.mocap_ns <= stop.sent_ns
        last_before_ns = int(log.mocap_ns[before_stop].max(initial=0))
        since_ns = min(stop.sent_ns - STOP_REPEATED_NS, last_before_ns)
        may_be_last = log.mocap_ns >= since_ns
        rows = log.mocap[may_be_last]
    ends = [np.ascontiguousarray(row).tobytes() for row in rows]
    return np.ascontiguousarray(final.array()).tobytes() in ends


TURN = 1.0
"""Largest difference of a turn from the one computed again, in its standard errors. It is 0 in
virtual time. In a lab's threads a frame that arrives in the last millisecond before a start may be
seen before or after it. Then all blocks of motion begin one frame earlier or later: up to 0.71
(20 trials of cubes, whose poses are coarse) and 0.05 (20 of m3pi robots), emulated."""
TURN_STD = 0.1
"""Largest difference of a turn's standard error from the one computed again, relative: up to 0.046
by the same, in the same trials."""


def _turns(log: TrialLog, verdict: Verdict) -> Iterator[Difference]:
    """Check how fast the robots turned by themselves, by a guard that sees the trial again."""
    if not verdict.turn:  # logs before 2026-11 have none
        return
    rates, errors = _turning(log)
    if len(rates) != len(verdict.turn):
        text = f"states {len(verdict.turn)} turns, the frames show {len(rates)}"
        yield Difference(None, "result.turn", text)
        return
    stated = zip(verdict.turn, verdict.turn_std, rates, errors, strict=True)
    for i, (rate, error, again, std) in enumerate(stated):
        if np.isfinite(std) and abs(rate - again) > TURN * std:
            yield Difference(None, f"result.turn.{i}", f"states {rate}, the frames show {again}")
        if not np.isclose(error, std, rtol=TURN_STD):
            yield Difference(None, f"result.turn_std.{i}", f"states {error}, not {std}")


def _turning(log: TrialLog) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the rates (N,) at which robots on wheels turn by themselves, and their standard errors
    [rad/s], as the guard states them at the end."""
    lab = log.experiment.plant
    setup = log.start.setup
    if not isinstance(lab, LabSection) or setup.wheel_radius is None:
        return (), ()
    guard = Guard(guard_rules(setup, lab.limits))
    guard.pass_preflight()
    # the inner loop first takes the frames that have come, and then sends
    events = [(int(t_ns), False, i) for i, t_ns in enumerate(log.received_ns)]
    events += [(command.sent_ns, True, i) for i, command in enumerate(log.commands)]
    for t_ns, is_command, i in sorted(events):
        if is_command:
            _send(guard, log.commands[i], t_ns, setup.wheel_radius)
        else:
            guard.check_frame(_frame(log, i))
    return guard.drift.turning()


def _send(guard: Guard, command: Command, t_ns: int, radius: float) -> None:
    """Let a guard take a command to robots with wheels at a radius [length unit]."""
    if command.stops:
        guard.end_run()
    elif guard.state is GuardState.READY:
        guard.start_run(t_ns)
    if command.left is not None and command.right is not None:
        speed, turning = body_velocity(command.left, command.right, radius)
        guard.note_transmission(t_ns, speed.tolist(), turning.tolist())


def _frame(log: TrialLog, i: int) -> CameraFrame:
    """Return the camera frame of row i."""
    poses = tuple(
        Pose(*row) if valid else None
        for row, valid in zip(log.mocap[i].tolist(), log.valid[i], strict=True)
    )
    seen_at = log.sample(i).observation
    return CameraFrame(
        seen_at.frame, seen_at.sampled_ns, seen_at.received_ns, poses, exposed_ns=seen_at.exposed_ns
    )
