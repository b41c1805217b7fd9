"""Checks what only the lab knows against the logged frames and commands: the order of times, the
rest at the end, distances, duration and final poses.
"""

from collections.abc import Iterator

import numpy as np

from tetractl.core.clock import SECOND, seconds
from tetractl.core.commands import HALTS, Command, Verdict
from tetractl.core.plan import Outcome
from tetractl.core.poses import Poses
from tetractl.core.setup import MM
from tetractl.core.trial import Result
from tetractl.experiment.lab_section import STANDSTILL_MM_S, UNTRACKED_STOP_S, LabSection
from tetractl.lab.rest_check import REST_NS
from tetractl.log.read.reader import trial_path
from tetractl.log.read.trial_log import TrialLog
from tetractl.model.path_check import check_path
from tetractl.replay.comparison import Difference

DISTANCE_TOLERANCE = 1e-6  # of a least distance, relative
STOP_REPEATED_NS = 500_000_000  # longest time from a stop's first repetition to its last
# A lab trial's final poses must be those of one of this many last frames: once, logs had some more.
LAST_FRAMES = 120
SLACK = 2.0  # frames after the guard's last check may exceed the guard's limits by this factor


def lab_differences(log: TrialLog, result: Result, stop: Command) -> Iterator[Difference]:
    """Yield what in an undamaged log of the lab contradicts its frames and commands."""
    yield from _frames(log)
    yield from _steps(log)
    if log.steps and stop.sent_ns < log.steps[-1].command.sent_ns:
        yield Difference(None, "stop.sent_ns", "the stop comes before the last step")
    if result.outcome.complete:
        yield from _rest(log)
    yield from _lasted(log, result, stop)
    if not result.outcome.complete and _untold(result.verdict):
        return  # an error ended the trial while the robots came to rest
    if not _stands(log, result.verdict.final, stop):
        yield Difference(None, "result.final", "differs from the robots' last poses")
    yield from _obstacles(log, result.verdict, stop)


def _untold(verdict: Verdict) -> bool:
    """Return whether a verdict states nothing, as `Verdict.unknown`."""
    told = any(verdict.entered) or bool(np.isfinite(verdict.clearance).any())
    return not told and bool(np.isnan(verdict.final.array()).all())


def _frames(log: TrialLog) -> Iterator[Difference]:
    """Check that frame numbers and times increase, and that no frame is received before its
    exposure. A frame counter may go back, which aborts a trial, but not before its last step.
    """
    aborted = log.result is not None and log.result.outcome is Outcome.ABORTED
    steered_ns = log.steps[-1].observation.sampled_ns if log.steps else -1
    for name, values, least in (
        ("frames", log.frames, 1),
        ("sampled_ns", log.mocap_ns, 1),
        ("received_ns", log.received_ns, 0),
    ):
        for i in np.flatnonzero(np.diff(values) < least):
            if name == "frames" and aborted and log.mocap_ns[i] >= steered_ns:
                continue
            text = f"goes from {values[i]} to {values[i + 1]} after frame {log.frames[i]}"
            yield Difference(None, f"mocap.{name}", text)
    own, at = log.exposed_ns, log.mocap_ns[:, None]
    for i in np.flatnonzero(
        (own > at).any(axis=1) | (np.diff(own, axis=0, prepend=own[:1]) < 0).any(1)
    ):
        text = f"in frame {log.frames[i]} a pose is later than its frame, or earlier than before"
        yield Difference(None, "mocap.exposed_ns", text)
    for i in np.flatnonzero(log.received_ns < log.mocap_ns):
        text = f"frame {log.frames[i]} was received before its exposure"
        yield Difference(None, "mocap.received_ns", text)


def _steps(log: TrialLog) -> Iterator[Difference]:
    """Check that each control step follows its frame, which is logged, and the step before."""
    numbers, sent_before, frame_before = set(log.frames.tolist()), -1, -1
    for step in log.steps:
        at, sent = step.observation, step.command.sent_ns
        if not at.sampled_ns <= at.received_ns <= sent:
            text = f"sampled {at.sampled_ns}, received {at.received_ns}, sent {sent}"
            yield Difference(step.k, "observation", f"times out of order: {text}")
        if sent <= sent_before or at.frame < frame_before:
            yield Difference(step.k, "command.sent_ns", "not later than in the previous step")
        if numbers and min(numbers) < at.frame and at.frame not in numbers:
            text = f"frame {at.frame} is not among the camera frames"
            yield Difference(step.k, "observation.frame", text)
        sent_before, frame_before = sent, at.frame


def _obstacles(log: TrialLog, verdict: Verdict, stop: Command) -> Iterator[Difference]:
    """Check the distances and the entered obstacles in the verdict against the logged path.

    The plant of a lab evaluates only the frames between the first step and the stop. A stated
    distance must therefore lie between the least distance in all frames and the least distance in
    the evaluated frames.
    """
    path, known = trial_path(log)
    least = check_path(log.start.setup, path, known, verdict.final)
    since = log.steps[0].command.sent_ns if log.steps else stop.sent_ns
    driven = (log.received_ns > since) & (log.received_ns <= stop.sent_ns)
    most = check_path(log.start.setup, path[driven], known[driven], verdict.final)
    for name in ("clearance", "edge", "apart"):
        columns = (getattr(one, name) for one in (verdict, least, most))
        for i, (stated, low, high) in enumerate(zip(*columns, strict=False)):
            floor = low - DISTANCE_TOLERANCE * max(1.0, abs(low)) if np.isfinite(low) else -np.inf
            if not (floor <= stated <= high + DISTANCE_TOLERANCE * max(1.0, abs(high))):
                text = f"states {stated}, the frames show {low} to {high}"
                yield Difference(None, f"result.{name}.{i}", text)
    for i, (stated, touches) in enumerate(zip(verdict.entered, least.entered, strict=True)):
        if stated != touches:
            text = f"states {stated}, but the logged path gives {touches}"
            yield Difference(None, f"result.entered.{i}", text)


def _rest(log: TrialLog) -> Iterator[Difference]:
    """Check that a complete trial in the lab ends with every robot tracked, and at rest if robots
    of this kind can halt; robots lost on the way are left out.
    """
    lab, now = log.experiment.plant, log.mocap_ns
    if not isinstance(lab, LabSection) or not len(now):
        return
    halts = log.start.plant.facts.get(HALTS) == "yes"
    for i, (name, gone) in enumerate(zip(log.start.setup.names, log.tour.gone, strict=True)):
        if gone:
            continue
        seen = np.flatnonzero(log.valid[:, i])
        unseen_s = seconds(int(now[-1] - (now[seen[-1]] if len(seen) else 0)))
        if unseen_s > SLACK * UNTRACKED_STOP_S:
            text = f"complete, but {name} was not tracked for the last {unseen_s:.2f} s"
            yield Difference(None, "result.outcome", text)
            continue
        last = seen[now[seen] >= now[-1] - REST_NS]
        gone_mm = np.hypot(*(log.mocap[last[-1], i, :2] - log.mocap[last[0], i, :2]))
        gone_mm *= log.start.setup.metres / MM
        span_s = seconds(int(now[last[-1]] - now[last[0]]))
        if halts and gone_mm > SLACK * STANDSTILL_MM_S * span_s:
            text = f"complete, but {name} moved by {gone_mm:.0f} mm in the last {span_s:.2f} s"
            yield Difference(None, "result.outcome", text)


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
        before = int(log.mocap_ns[log.mocap_ns <= stop.sent_ns].max(initial=0))
        rows = log.mocap[log.mocap_ns >= min(stop.sent_ns - STOP_REPEATED_NS, before)]
    ends = [np.ascontiguousarray(row).tobytes() for row in rows]
    return np.ascontiguousarray(final.array()).tobytes() in ends
