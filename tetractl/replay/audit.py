"""Checks that a log agrees with itself: values stored twice must be equal, and values that follow
from other records must match them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tetractl.core.clock import SECOND, milliseconds, seconds
from tetractl.core.commands import HALTS, Command, Verdict
from tetractl.core.plan import Outcome
from tetractl.core.poses import Poses
from tetractl.core.setup import MM
from tetractl.core.trial import Result, Step
from tetractl.experiment.lab_section import STANDSTILL_MM_S, UNTRACKED_STOP_S, LabSection
from tetractl.lab.rest_check import REST_NS
from tetractl.log.format.metadata import FORMAT, run_metadata
from tetractl.log.read.reader import path_verdict, trial_path
from tetractl.log.read.trial_log import ALTERED, TrialLog, frame_gaps, step_gaps
from tetractl.replay.difference import EXACT, Difference, Tolerance, first_difference
from tetractl.replay.recompute import ROUNDING

REST = 1e-6  # tolerance for the position of a robot at rest, relative to a coordinate
STOPPING_S = 1.0  # longest time until a stop is sent on a busy host
STOPPING_NS = 500_000_000  # longest time from a stop's first repetition to its last
LAST_FRAMES = 120  # a lab trial's final poses must be those of one of this many last frames
SLACK = 2.0  # frames after the guard's last check may exceed the guard's limits by this factor


@dataclass(slots=True)
class Audit:
    """The contradictions found in a log (`problems`), and remarks on harmless facts (`notes`)."""

    problems: list[Difference] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def audit(log: TrialLog, same_host: bool) -> Audit:
    """Check the records of a log against each other.

    `same_host` is whether this machine wrote the log, with these versions; then computed values
    must have the same bits.
    """
    findings = Audit()
    findings.problems += _run(log)
    if log.altered:
        findings.problems.append(Difference(None, "content_digest", ALTERED))
    if log.host_altered and not log.damage:
        text = "the records of the host do not match the digest that the log states"
        findings.problems.append(Difference(None, "host_digest", text))
    findings.problems += _frames(log)
    findings.problems += _steps(log)
    for gap in frame_gaps(log):
        if not log.experiment.plant.loses_frames or log.damage:
            findings.problems.append(Difference(None, "frames", f"missing: {gap}"))
        else:  # datagrams may get lost
            findings.notes.append(f"missing: {gap}")
    for gap in step_gaps(log):
        findings.problems.append(Difference(gap.first, "k", f"missing: {gap}"))
    if log.result is not None:
        findings.problems += _result(log, log.result, same_host)
    if log.damage:
        texts = (*log.damage.problems, *(f"lost: {lost}" for lost in log.damage.lost))
        findings.problems += [Difference(None, "damage", text) for text in texts]
    return findings


def _run(log: TrialLog) -> Iterator[Difference]:
    """Check the run record against the resolved spec and the start of the trial."""
    ours = run_metadata(replace(log.start, seed=log.experiment.trials.seed))
    if log.run.get(FORMAT) == "1":
        ours[FORMAT] = "1"
    for key in sorted(ours.keys() | log.run.keys()):
        if ours.get(key) != log.run.get(key):
            text = f"states {log.run.get(key)!r}, but the resolved spec and the run give "
            yield Difference(None, f"run.{key}", text + repr(ours.get(key)))


def _frames(log: TrialLog) -> Iterator[Difference]:
    """Check that frame numbers and times increase, and that no frame is received before its
    exposure.
    """
    for name, values, least in (
        ("frames", log.frames, 1),
        ("sampled_ns", log.mocap_ns, 1),
        ("received_ns", log.received_ns, 0),
    ):
        for i in np.flatnonzero(np.diff(values) < least):
            text = f"goes from {values[i]} to {values[i + 1]} after frame {log.frames[i]}"
            yield Difference(None, f"mocap.{name}", text)
    for i in np.flatnonzero(log.received_ns < log.mocap_ns):
        yield Difference(
            None, "mocap.received_ns", f"frame {log.frames[i]} was received before its exposure"
        )


def _steps(log: TrialLog) -> Iterator[Difference]:
    """Check that each control step names a logged frame and a logged command, that both follow
    those of the step before, and that the command is the first signal of the step's plan.
    """
    rows = {int(number): i for i, number in enumerate(log.frames)}
    sent: dict[int, list[Command]] = {}
    for command in log.commands:  # the stop may have the time of the last step
        sent.setdefault(command.sent_ns, []).append(command)
    period_ns = round(log.experiment.controller.period * SECOND)
    before: Step | None = None
    for step in log.steps:
        at, k, command = step.observation, step.k, step.command
        yield from _order(step, before)
        i = rows.get(at.frame)
        if i is not None:
            yield from _at(k, first_difference(at, log.sample(i).observation, name="observation"))
        elif rows and min(rows) < at.frame and not log.damage:
            yield Difference(
                k, "observation.frame", f"frame {at.frame} is not among the camera frames"
            )
        found = first_difference(step.plan.direction, command.direction, name="command.direction")
        yield from _at(k, found)
        same_time = sent.get(command.sent_ns, ())
        if all(first_difference(command, one) for one in same_time) and not log.damage:
            yield Difference(k, "command", "differs from the message on /commands")
        standing = k == 0 or (before is not None and before.plan.pauses)
        late = not standing and step.solve_ns > period_ns
        if step.deadline_missed != late:
            text = f"states {step.deadline_missed}, solved in {milliseconds(step.solve_ns):.3f} ms"
            yield Difference(k, "timing.deadline_missed", text)
        before = step


def _at(k: int | None, found: tuple[str, str] | None) -> Iterator[Difference]:
    """Yield a result of `first_difference` as a `Difference` in step `k`; nothing for None."""
    if found:
        yield Difference(k, *found)


def _order(step: Step, before: Step | None) -> Iterator[Difference]:
    at, sent = step.observation, step.command.sent_ns
    if not at.sampled_ns <= at.received_ns <= sent:
        text = f"sampled {at.sampled_ns}, received {at.received_ns}, sent {sent}"
        yield Difference(step.k, "observation", f"times out of order: {text}")
    if before is None:
        return
    if sent <= before.command.sent_ns or at.frame < before.observation.frame:
        yield Difference(step.k, "command.sent_ns", "not later than in the previous step")


def _result(log: TrialLog, result: Result, same_host: bool) -> Iterator[Difference]:
    """Check the result against the final poses and the steps; in the lab also against the
    frames.
    """
    verdict, simulated = result.verdict, log.start.plant.simulated
    ours = Result.of(
        log.start.setup,
        verdict,
        outcome=result.outcome,
        reason=result.reason,
        duration_s=result.duration_s,
        solve_ns=tuple(step.solve_ns for step in log.steps),
        deadline_misses=sum(step.deadline_missed for step in log.steps),
        tour=log.tour,
    )
    if log.damage:  # steps may be lost
        lost = {"steps": result.steps, "solve_ns": result.solve_ns}
        lost |= {"passed": result.passed, "inside": result.inside, "lost": result.lost}
        ours = replace(ours, **lost, deadline_misses=result.deadline_misses)
    tolerance = EXACT if same_host else Tolerance(ROUNDING, ROUNDING)
    yield from _at(None, first_difference(ours, result, tolerance, "result"))
    yield from _ending(log, result)
    if not simulated:
        yield from _lab(log, result)


def _lab(log: TrialLog, result: Result) -> Iterator[Difference]:
    """Check the result of a trial in the lab against the logged frames and commands."""
    if not log.damage:
        if not _stands(log, result.verdict.final):
            yield Difference(None, "result.final", "differs from the robots' last poses")
        if result.outcome.complete:
            yield from _rest(log)
        if log.stop:
            yield from _lasted(log, result, log.stop)
    yield from _obstacles(log, result.verdict)


def _obstacles(log: TrialLog, verdict: Verdict) -> Iterator[Difference]:
    """Check the distances and the entered obstacles in the verdict against the logged path.

    The plant of a lab evaluates only the frames between the first step and the stop. A stated
    distance must therefore lie between the least distance in all frames and the least distance in
    the evaluated frames. In a damaged log, where frames may be lost, distances are not checked.
    """
    path, known = trial_path(log)
    least = most = path_verdict(log, path, known, verdict.final)
    if log.stop:
        since = log.steps[0].command.sent_ns if log.steps else log.stop.sent_ns
        driven = (log.received_ns > since) & (log.received_ns <= log.stop.sent_ns)
        most = path_verdict(log, path[driven], known[driven], verdict.final)
    for name in ("clearance", "edge", "apart"):
        columns = (getattr(one, name) for one in (verdict, least, most))
        for i, (stated, low, high) in enumerate(zip(*columns, strict=False)):
            floor = low - REST * max(1.0, abs(low)) if np.isfinite(low) else -np.inf
            if not (floor <= stated <= high + REST * max(1.0, abs(high)) or log.damage):
                text = f"states {stated}, the frames show {low} to {high}"
                yield Difference(None, f"result.{name}.{i}", text)
    for i, (stated, touches) in enumerate(zip(verdict.entered, least.entered, strict=True)):
        if verdict.clearance[i] < 0 and not stated:
            text = f"states false, but the clearance is {verdict.clearance[i]}"
            yield Difference(None, f"result.entered.{i}", text)
        elif stated != touches and not (stated and log.damage):
            text = f"states {stated}, but the logged path gives {touches}"
            yield Difference(None, f"result.entered.{i}", text)


def _ending(log: TrialLog, result: Result) -> Iterator[Difference]:
    if log.stop is None and not log.damage:
        yield Difference(None, "stop", "missing: no stop is on /commands")
    if log.stop and log.steps and log.stop.sent_ns < log.steps[-1].command.sent_ns:
        yield Difference(None, "stop.sent_ns", "the stop comes before the last step")
    if result.outcome is Outcome.ABORTED and not result.reason:
        yield Difference(None, "result.reason", "aborted without a reason")


def _rest(log: TrialLog) -> Iterator[Difference]:
    """Check that a complete trial in the lab ends with every robot tracked, and at rest if robots
    of this kind can halt; robots lost on the way are left out.
    """
    lab, now = log.experiment.plant, log.mocap_ns
    if not isinstance(lab, LabSection) or not len(now):
        return
    halts = log.start.plant.facts.get(HALTS) == "yes"  # early logs lack this fact
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
    """Check the duration of a trial in the lab: it must count from a time between the first frame
    and the first command.
    """
    first = min((command.sent_ns for command in log.commands), default=stop.sent_ns)
    opened = int(log.received_ns[0]) if len(log.received_ns) else 0
    least, most = seconds(stop.sent_ns - first), seconds(stop.sent_ns - min(opened, first))
    if not least - 1e-6 <= result.duration_s <= most + STOPPING_S:
        text = f"states {result.duration_s} s, but the commands give {least} to {most} s"
        yield Difference(None, "result.duration_s", text)


def _stands(log: TrialLog, final: Poses) -> bool:
    """Return whether the final poses are those of one of the last frames or, for robots that swim
    on after the stop, of any frame since STOPPING_NS before the stop.
    """
    if not len(log.mocap):
        return True
    rows = log.mocap[-LAST_FRAMES:]
    if log.stop and log.start.plant.facts.get(HALTS) == "no":
        rows = log.mocap[log.mocap_ns >= log.stop.sent_ns - STOPPING_NS]
    ends: Sequence[bytes] = [np.ascontiguousarray(row).tobytes() for row in rows]
    return np.ascontiguousarray(final.array()).tobytes() in ends
