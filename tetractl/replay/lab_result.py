"""Computes again what tables use of a lab's log, from its frames and commands, and yields where
the log's result differs: errors, final poses, duration, least distances, entered obstacles, turns.

A lab cannot run a trial again, so each value of the result is compared with what frames and
commands show. A least distance is that of a robot to obstacles, to the arena's edge or to other
robots [length unit]; a turn is the rate at which a robot on wheels turns by itself [rad/s].

A log does not say which of its first and last frames the plant had read when it stated the result,
since its threads run at times of their own. Where a value depends on that, it must lie between the
values for all logged frames and for those that the plant had surely read.
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

STOP_REPEATED_NS = 500_000_000
"""Longest time from a stop's first repetition to its last [ns]; `log.stop` may be any of these."""
LAST_FRAMES = 120
"""The final poses of robots that stand must be those of one of this many last frames: older logs
have some frames more after these."""
TURN_ERRORS = 1.0
"""Largest difference between a stated turn and the one computed again, in standard errors.

In virtual time the two are the same. In a lab's threads a frame that arrives in the last
millisecond before a start may be seen before or after it, and then all blocks of motion begin one
frame earlier or later: a turn then differs by up to 0.71 standard errors (20 emulated trials of
cubes, whose poses are coarse) or 0.05 (20 of m3pi robots)."""
TURN_STD_SHARE = 0.1
"""Largest difference between a turn's standard errors, as a share, for the same reason: up to
0.046 in the same trials."""


def lab_differences(log: TrialLog, result: Result) -> Iterator[Difference]:
    """Yield what in the result of an undamaged log its frames and commands contradict."""
    if log.stop is None:
        return
    yield from _lasted(log, result, log.stop)
    yield from error_differences(log, result)
    if result.outcome.complete or not untold(result.verdict):
        if not _stands(log, result.verdict.final, log.stop):
            yield Difference(None, "result.final", "differs from the robots' last poses")
        yield from _paths(log, result.verdict, log.stop)
    if result.outcome.complete:  # no log says when the guard of another aborted it
        yield from _turns(log, result.verdict)


def untold(verdict: Verdict) -> bool:
    """Return whether a verdict is that of a trial whose end is unknown: no final poses, no distance
    to an obstacle, and nothing entered.
    """
    if any(verdict.entered) or np.isfinite(verdict.clearance).any():
        return False
    final = verdict.final.array()
    return bool(np.isnan(final).all())


def error_differences(log: TrialLog, result: Result) -> Iterator[Difference]:
    """Yield the first value of a result that contradicts its final poses, its tour, or the solve
    times of its steps.
    """
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


def _paths(log: TrialLog, verdict: Verdict, stop: Command) -> Iterator[Difference]:
    """Check the least distances and the entered obstacles in the verdict against the logged path.

    The frames between the first step and the stop have surely been read: a stated distance lies
    between the least of all frames and the least of these. The obstacles entered are those of all
    frames.

    A pose that came too late for its robot to count as tracked (`is_known`, but not `is_tracked`)
    may be a place on its path: its frame is open, as one that was not surely read. The other robots
    were elsewhere in it, so that no distance between robots follows from it.
    """
    path, is_tracked = trial_path(log)
    is_known = np.asarray(np.isfinite(path).all(axis=2))
    setup = log.start.setup
    of_all = check_path(setup, path, is_known, verdict.final)
    apart_of_all = tracked_separations(path, is_tracked).tolist()
    first_step_ns = log.steps[0].command.sent_ns if log.steps else stop.sent_ns
    is_read = (log.received_ns > first_step_ns) & (log.received_ns <= stop.sent_ns)
    of_read = check_path(setup, path[is_read], is_tracked[is_read], verdict.final)
    is_open = ~is_read | (is_known & ~is_tracked).any(axis=1)
    alone = [slice(i, i + 1) for i in np.flatnonzero(is_open)]
    of_open = [check_path(setup, path[i], is_known[i], verdict.final) for i in alone]
    clearances = [frame.clearance for frame in of_open]
    edges = [frame.edge for frame in of_open]
    aparts = [tracked_separations(path[i], is_tracked[i]).tolist() for i in alone]
    yield from _distances(
        "clearance", verdict.clearance, of_all.clearance, of_read.clearance, clearances
    )
    yield from _distances("edge", verdict.edge, of_all.edge, of_read.edge, edges)
    yield from _distances("apart", verdict.apart, apart_of_all, of_read.apart, aparts)
    for i, (stated, entered) in enumerate(zip(verdict.entered, of_all.entered, strict=True)):
        if stated != entered:
            text = f"states {stated}, but the logged path gives {entered}"
            yield Difference(None, f"result.entered.{i}", text)


def _distances(
    name: str,
    stated: Sequence[float],
    of_all: Sequence[float],
    of_read: Sequence[float],
    of_open: Sequence[Sequence[float]],
) -> Iterator[Difference]:
    """Check that each stated least distance is between that of all frames and that of the frames
    read, and is the latter or that of one of the open frames (K, N). Logs of older
    versions state no `edge` and no `apart`: then none is checked.
    """
    for i, (distance, least, most) in enumerate(zip(stated, of_all, of_read, strict=False)):
        of_frames = {most, *(frame[i] for frame in of_open)}
        if not least <= distance <= most or distance not in of_frames:
            text = f"states {distance}, the frames show {least} to {most}"
            yield Difference(None, f"result.{name}.{i}", text)


def _lasted(log: TrialLog, result: Result, stop: Command) -> Iterator[Difference]:
    """Check the duration of a trial: from the first direction to the stop, or without a direction
    at most from a second before the first frame, since when the devices are open.
    """
    directed = [command.sent_ns for command in log.commands if not command.stops]
    opened = int(log.received_ns[0]) - SECOND if len(log.received_ns) else 0
    least = seconds(stop.sent_ns - min(directed, default=stop.sent_ns))
    most = least if directed else seconds(stop.sent_ns - opened)
    if not least <= result.duration_s <= most:
        text = f"states {result.duration_s} s, but the commands give {least} to {most} s"
        yield Difference(None, "result.duration_s", text)


def _stands(log: TrialLog, final: Poses, stop: Command) -> bool:
    """Return whether the final poses are, to the bit, those of one of the last frames.

    Robots that swim on have their final poses when the stop was first sent, and `log.stop` may be
    its last repetition: those of any frame since STOP_REPEATED_NS before it or, if pictures ended
    earlier, since the last frame before it.
    """
    if not len(log.mocap):
        return True
    if log.start.plant.facts.get(HALTS) == "no":
        is_before_stop = log.mocap_ns <= stop.sent_ns
        last_before_ns = int(log.mocap_ns[is_before_stop].max(initial=0))
        since_ns = min(stop.sent_ns - STOP_REPEATED_NS, last_before_ns)
        rows = log.mocap[log.mocap_ns >= since_ns]
    else:
        rows = log.mocap[-LAST_FRAMES:]
    ends = [np.ascontiguousarray(row).tobytes() for row in rows]
    return np.ascontiguousarray(final.array()).tobytes() in ends


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
        if np.isfinite(std) and not abs(rate - again) <= TURN_ERRORS * std:
            yield Difference(None, f"result.turn.{i}", f"states {rate}, the frames show {again}")
        if not np.isclose(error, std, rtol=TURN_STD_SHARE):
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
            _take_command(guard, log.commands[i], t_ns, setup.wheel_radius)
        else:
            guard.check_frame(_frame(log, i))
    return guard.drift.turning()


def _take_command(guard: Guard, command: Command, t_ns: int, radius: float) -> None:
    """Let a guard take a command to robots whose wheels are at `radius` from their centres
    [length unit]."""
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
