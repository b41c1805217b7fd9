"""Checks the result in a lab's log by the frames and commands in it: what tables use of a trial
must be what these give.

A lab cannot run a trial again, so each value is computed again: the duration from the commands; the
errors from the final poses, and these must be a logged frame's; least distances to obstacles, to
the arena's edge and to other robots [length unit], and which obstacles were entered, from the path.
The log has the same numbers from which the lab computed them, so that equal means equal.

The lab's threads run at times of their own: a log does not say which of its first and last frames
had been read when the result was stated. Where a value depends on that, any of them may be right.
"""

from collections.abc import Iterator

import numpy as np

from tetractl.core.clock import SECOND, seconds
from tetractl.core.commands import Command
from tetractl.core.poses import Bools, Floats, Poses
from tetractl.core.trial import HALTS, Result, Verdict
from tetractl.log.read.reader import trial_path
from tetractl.log.read.trial_log import TrialLog
from tetractl.model.path_check import check_path, tracked_separations
from tetractl.replay.comparison import Difference, first_difference

STOP_REPEATED_NS = 500_000_000
"""Longest time from a stop's first repetition to its last [ns]; `log.stop` may be any of these."""


def lab_differences(log: TrialLog, result: Result) -> Iterator[Difference]:
    """Yield what in the result of an undamaged log its frames and commands contradict."""
    if log.stop is None:
        return
    yield from _lasted(log, result, log.stop)
    yield from error_differences(log, result)
    verdict = result.verdict
    # a trial whose end is unknown has no final poses, no distance to an obstacle, and entered none
    is_told = any(verdict.entered) or np.isfinite(verdict.clearance).any()
    is_told = is_told or not np.isnan(verdict.final.array()).all()
    if result.outcome.complete or is_told:
        yield from _final_poses(log, verdict, log.stop)
        yield from _paths(log, verdict, log.stop)


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


def _final_poses(log: TrialLog, verdict: Verdict, stop: Command) -> Iterator[Difference]:
    """Check that the final poses are those of the last frame or, of robots that swim on, those of
    a frame when the stop was first sent: one of the last STOP_REPEATED_NS before `log.stop` or
    later or, if pictures ended earlier, the last one before it.
    """
    frames = log.mocap[-1:]
    if log.start.plant.facts.get(HALTS) == "no":
        is_before = log.mocap_ns <= stop.sent_ns
        last_before_ns = int(log.mocap_ns[is_before].max(initial=0))
        is_late = log.mocap_ns >= min(stop.sent_ns - STOP_REPEATED_NS, last_before_ns)
        frames = log.mocap[is_late]
    final = verdict.final.array()
    if len(log.mocap) and not any(np.array_equal(frame, final, equal_nan=True) for frame in frames):
        yield Difference(None, "result.final", "differs from the robots' last poses")


def _paths(log: TrialLog, verdict: Verdict, stop: Command) -> Iterator[Difference]:
    """Check the entered obstacles and the least distances (N,) in a verdict against the path."""
    path, is_tracked = trial_path(log)
    is_known = np.asarray(np.isfinite(path).all(axis=2))
    possible = _possible_distances(log, path, is_known, is_tracked, verdict.final, stop)
    for name, stated in (
        ("clearance", verdict.clearance),
        ("edge", verdict.edge),
        ("apart", verdict.apart),
    ):
        for i, distance in enumerate(stated):
            of_robot = possible[name][:, i]
            if distance not in of_robot:
                text = f"states {distance}, the frames show {of_robot.min()} to {of_robot[0]}"
                yield Difference(None, f"result.{name}.{i}", text)
    entered = check_path(log.start.setup, path, is_known, verdict.final).entered
    for i, (stated, again) in enumerate(zip(verdict.entered, entered, strict=True)):
        if stated != again:
            text = f"states {stated}, but the logged path gives {again}"
            yield Difference(None, f"result.entered.{i}", text)


def _possible_distances(
    log: TrialLog, path: Floats, is_known: Bools, is_tracked: Bools, final: Poses, stop: Command
) -> dict[str, Floats]:
    """Return the values that each least distance of a robot may have (V, N), by name, along the
    path (F, N, 3) of which poses are known and tracked (F, N).

    The frames between the first step and the stop have surely been read, and row 0 is of these. The
    others are each of these with a frame that is open: one that was perhaps read, or with a pose
    that came too late for its robot to count as tracked, and may be a place on its path. Where the
    other robots were then is not known: no distance between robots follows from such a pose.
    """
    setup = log.start.setup
    first_step_ns = log.steps[0].command.sent_ns if log.steps else stop.sent_ns
    is_read = (log.received_ns > first_step_ns) & (log.received_ns <= stop.sent_ns)
    is_open = ~is_read | (is_known & ~is_tracked).any(axis=1)
    of_read = check_path(setup, path[is_read], is_tracked[is_read], final)
    clearances = [of_read.clearance]
    edges = [of_read.edge]
    aparts = [of_read.apart]
    for row in np.flatnonzero(is_open):
        frame = slice(row, row + 1)
        alone = check_path(setup, path[frame], is_known[frame], final)
        clearances.append(alone.clearance)
        edges.append(alone.edge)
        apart = tracked_separations(path[frame], is_tracked[frame])
        aparts.append(tuple(apart.tolist()))
    return {
        "clearance": np.minimum(of_read.clearance, clearances),
        "edge": np.minimum(of_read.edge, edges),
        "apart": np.minimum(of_read.apart, aparts),
    }
