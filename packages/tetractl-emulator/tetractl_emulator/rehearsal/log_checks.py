"""Checks that a lab's log is consistent: the order of times, and the rest at the end."""

from collections.abc import Iterator

import numpy as np

from tetractl.core.clock import seconds
from tetractl.core.plan import Outcome
from tetractl.core.setup import MM
from tetractl.core.trial import HALTS
from tetractl.experiment.lab_section import STANDSTILL_MM_S, UNTRACKED_STOP_S, LabSection
from tetractl.lab.rest_check import REST_NS
from tetractl.log.read.trial_log import TrialLog
from tetractl.replay.comparison import Difference
from tetractl.replay.lab_result import lab_differences

SLACK = 2.0  # frames after the guard's last check may exceed the guard's limits by this factor


def log_differences(log: TrialLog) -> Iterator[Difference]:
    """Yield what in an undamaged log of the lab contradicts its frames and commands."""
    if log.result is None or log.stop is None:
        yield Difference(None, "stop", "missing: no stop is on /commands")
        return
    yield from lab_differences(log, log.result)
    yield from _frames(log)
    yield from _steps(log)
    if log.steps and log.stop.sent_ns < log.steps[-1].command.sent_ns:
        yield Difference(None, "stop.sent_ns", "the stop comes before the last step")
    if log.result.outcome.complete:
        yield from _rest(log)


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
    exposed_ns = log.exposed_ns
    frame_ns = log.mocap_ns[:, None]
    is_later = (exposed_ns > frame_ns).any(axis=1)
    goes_back = (np.diff(exposed_ns, axis=0, prepend=exposed_ns[:1]) < 0).any(axis=1)
    for i in np.flatnonzero(is_later | goes_back):
        text = f"in frame {log.frames[i]} a pose is later than its frame, or earlier than before"
        yield Difference(None, "mocap.exposed_ns", text)
    for i in np.flatnonzero(log.received_ns < log.mocap_ns):
        text = f"frame {log.frames[i]} was received before its exposure"
        yield Difference(None, "mocap.received_ns", text)


def _steps(log: TrialLog) -> Iterator[Difference]:
    """Check that each control step follows its frame, which is logged, and the step before."""
    numbers = set(log.frames.tolist())
    sent_before = -1
    frame_before = -1
    for step in log.steps:
        observation = step.observation
        sent = step.command.sent_ns
        if not observation.sampled_ns <= observation.received_ns <= sent:
            text = (
                f"sampled {observation.sampled_ns}, received {observation.received_ns}, sent {sent}"
            )
            yield Difference(step.k, "observation", f"times out of order: {text}")
        if sent <= sent_before or observation.frame < frame_before:
            yield Difference(step.k, "command.sent_ns", "not later than in the previous step")
        if numbers and min(numbers) < observation.frame and observation.frame not in numbers:
            text = f"frame {observation.frame} is not among the camera frames"
            yield Difference(step.k, "observation.frame", text)
        sent_before = sent
        frame_before = observation.frame


def _rest(log: TrialLog) -> Iterator[Difference]:
    """Check that a complete trial in the lab ends with every robot tracked, and at rest if robots
    of this kind can halt; robots lost on the way are left out.
    """
    lab = log.experiment.plant
    now = log.mocap_ns
    if not isinstance(lab, LabSection) or not len(now):
        return
    halts = log.start.plant.facts.get(HALTS) == "yes"
    for i, (name, gone) in enumerate(zip(log.start.setup.names, log.tour.gone, strict=True)):
        if gone:
            continue
        tracked = np.flatnonzero(log.valid[:, i])
        unseen_s = seconds(int(now[-1] - (now[tracked[-1]] if len(tracked) else 0)))
        if unseen_s > SLACK * UNTRACKED_STOP_S:
            text = f"complete, but {name} was not tracked for the last {unseen_s:.2f} s"
            yield Difference(None, "result.outcome", text)
            continue
        is_recent = now[tracked] >= now[-1] - REST_NS
        last = tracked[is_recent]
        gone_mm = np.hypot(*(log.mocap[last[-1], i, :2] - log.mocap[last[0], i, :2]))
        gone_mm *= log.start.setup.metres / MM
        span_s = seconds(int(now[last[-1]] - now[last[0]]))
        if halts and gone_mm > SLACK * STANDSTILL_MM_S * span_s:
            text = f"complete, but {name} moved by {gone_mm:.0f} mm in the last {span_s:.2f} s"
            yield Difference(None, "result.outcome", text)
