"""Checks a log against itself: values it states twice, and values that follow from others."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tetractl.core.clock import SECOND, milliseconds, seconds
from tetractl.core.commands import HALTS, Command, Verdict
from tetractl.core.plan import Outcome
from tetractl.core.poses import Bools, Floats, Observation, Poses
from tetractl.core.trial import Result, Step
from tetractl.experiment.lab import LabSection
from tetractl.lab.standstill import REST_NS
from tetractl.log.format import channels
from tetractl.log.format.metadata import run_metadata
from tetractl.log.read.gaps import frame_gaps, step_gaps
from tetractl.log.read.reader import judged, trial_path
from tetractl.log.read.trial_log import ALTERED, TrialLog
from tetractl.replay.recompute import Difference

REST = 1e-6  # relative to a coordinate: tolerance for the position of a robot at rest
STOPPING_S = 1.0  # the longest time until a stop is sent, on a host under load
LAST_FRAMES = 120  # of a lab trial, one of which shows the final poses
SLACK = 2.0  # times the lab's limits: a few frames come between its last look and the log's end
MM = 1e-3  # m


@dataclass(slots=True)
class Audit:
    """The contradictions in a log, and notes on it that are no contradictions."""

    problems: list[Difference] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def audit(log: TrialLog) -> Audit:
    """Check a log against itself; `recompute` checks the decisions."""
    findings = Audit()
    findings.problems += _run(log)
    if log.altered:
        findings.problems.append(Difference(None, "content_digest", ALTERED))
    if log.host_altered and not log.damage:
        text = "the records of the host do not match the digest that the log states"
        findings.problems.append(Difference(None, "host_digest", text))
    findings.problems += _frames(log)
    findings.problems += _steps(log)
    findings.problems += _stamps(log)
    findings.problems += _ends(log)
    for gap in frame_gaps(log):
        if not log.experiment.plant.loses_frames or log.damage:
            findings.problems.append(Difference(None, "frames", f"missing: {gap}"))
        else:  # a datagram may get lost on the way
            findings.notes.append(f"missing: {gap}")
    for gap in step_gaps(log):
        findings.problems.append(Difference(gap.first, "k", f"missing: {gap}"))
    if log.result is not None:
        findings.problems += _result(log, log.result)
    if log.damage:
        texts = (*log.damage.problems, *(f"lost: {lost}" for lost in log.damage.lost))
        findings.problems += [Difference(None, "damage", text) for text in texts]
    return findings


def _run(log: TrialLog) -> Iterator[Difference]:
    """The run record follows from the resolved spec and the start of the trial."""
    ours = run_metadata(replace(log.start, seed=log.experiment.trials.seed))
    for key in sorted(ours.keys() | log.run.keys()):
        if ours.get(key) != log.run.get(key):
            text = f"states {log.run.get(key)!r}, but the resolved spec and the run make it "
            yield Difference(None, f"run.{key}", text + repr(ours.get(key)))


def _frames(log: TrialLog) -> Iterator[Difference]:
    """Frame numbers and times rise, and no frame is received before its exposure."""
    for name, values, least in (
        ("frames", log.frames, 1),
        ("sampled_ns", log.mocap_ns, 1),
        ("received_ns", log.received_ns, 0),
    ):
        for i in np.flatnonzero(np.diff(values) < least):
            text = f"after frame {log.frames[i]} it goes from {values[i]} to {values[i + 1]}"
            yield Difference(None, f"mocap.{name}", text)
    for i in np.flatnonzero(log.received_ns < log.mocap_ns):
        yield Difference(
            None, "mocap.received_ns", f"frame {log.frames[i]} was received before its exposure"
        )


def _ends(log: TrialLog) -> Iterator[Difference]:
    """The frames of a simulation begin with the trial and end after the stop."""
    if not log.start.plant.simulated or log.damage:
        return
    if not len(log.frames) or log.frames[0] != 0:
        yield Difference(None, "frames", "missing: camera frame 0")
    elif log.stop is not None and log.mocap_ns[-1] < log.stop.sent_ns:
        yield Difference(None, "frames", f"missing: camera frames after {log.frames[-1]}")


def _steps(log: TrialLog) -> Iterator[Difference]:
    seen = {int(number): i for i, number in enumerate(log.frames)}
    sent: dict[int, list[Command]] = {}
    for command in log.commands:  # the stop may be sent together with the last step
        sent.setdefault(command.sent_ns, []).append(command)
    control, simulated = log.experiment.controller, log.start.plant.simulated
    planning_ns = round(log.experiment.plant.planning_max_s * SECOND)
    before: Step | None = None
    for step in log.steps:
        at, k = step.observation, step.k
        yield from _order(step, before, control.period if simulated else None, planning_ns)
        i = seen.get(at.frame)
        if i is not None and not _same_frame(at, log, i):
            yield Difference(k, "observation", f"differs from frame {at.frame} on /mocap")
        if i is None and seen and min(seen) < at.frame and not log.damage:
            yield Difference(k, "observation.frame", f"frame {at.frame} is not on /mocap")
        command = step.command
        if command.direction != step.plan.direction:
            text = f"sent {command.direction!r}, decided {step.plan.direction!r}"
            yield Difference(k, "command.direction", text)
        told = any(_same_command(command, one) for one in sent.get(command.sent_ns, ()))
        if not told and not log.damage:
            yield Difference(k, "command", "differs from what is on /commands")
        if simulated and k > 0 and not log.damage:
            asked = (command.sent_ns - planning_ns, command.sent_ns)
            first, newest = np.searchsorted(log.received_ns, asked, side="right") - 1
            if newest >= 0 and not log.frames[max(0, first)] <= at.frame <= log.frames[newest]:
                text = f"frame {at.frame} was decided on, the newest was {log.frames[newest]}"
                yield Difference(k, "observation.frame", text)
        late = k > 0 and step.solve_ns > round(control.period * SECOND)
        if step.deadline_missed != late:
            text = f"{step.deadline_missed} for {milliseconds(step.solve_ns):.3f} ms"
            yield Difference(k, "timing.deadline_missed", text)
        before = step


def _order(
    step: Step, before: Step | None, period: float | None, planning_ns: int
) -> Iterator[Difference]:
    at, sent = step.observation, step.command.sent_ns
    if not at.sampled_ns <= at.received_ns <= sent:
        text = f"sampled {at.sampled_ns}, received {at.received_ns}, sent {sent}"
        yield Difference(step.k, "observation", f"times out of order: {text}")
    if before is None:
        return
    if sent <= before.command.sent_ns or at.frame < before.observation.frame:
        yield Difference(step.k, "command.sent_ns", "not after the step before")
    if period is not None and step.k > 0 and before.k == step.k - 1:
        spaced = sent - before.command.sent_ns
        if abs(spaced - period * SECOND) > 1 + planning_ns:
            yield Difference(
                step.k, "command.sent_ns", f"{seconds(spaced)} s after the step before"
            )


def _same_frame(at: Observation, log: TrialLog, i: int) -> bool:
    times = (at.sampled_ns, at.received_ns) == (log.mocap_ns[i], log.received_ns[i])
    poses = np.ascontiguousarray(at.poses.array()).tobytes() == log.mocap[i].tobytes()
    return bool(times and poses and (at.valid == log.valid[i]).all())


def _same_command(one: Command, two: Command) -> bool:
    if (one.direction, one.delivered, one.stops) != (two.direction, two.delivered, two.stops):
        return False
    for ours, theirs in ((one.left, two.left), (one.right, two.right)):
        if (ours is None) != (theirs is None):
            return False
        if ours is not None and theirs is not None and ours.tobytes() != theirs.tobytes():
            return False
    return True


def _stamps(log: TrialLog) -> Iterator[Difference]:
    """The log and publish times of the messages are the times that the messages hold."""
    for topic, held in (
        (channels.MOCAP, list(zip(log.received_ns, log.mocap_ns, strict=True))),
        (channels.STEP, [(s.command.sent_ns, s.observation.sampled_ns) for s in log.steps]),
        (channels.COMMANDS, [(c.sent_ns, c.sent_ns) for c in log.commands]),
        (
            channels.ESTIMATE,
            [
                (s.command.sent_ns, s.observation.sampled_ns)
                for s in log.steps
                if s.plan.estimate is not None
            ],
        ),
    ):
        stamps = log.stamps.get(topic, [])
        if len(stamps) != len(held):
            if log.damage is None:
                yield Difference(None, topic, f"{len(stamps)} messages for {len(held)} steps")
            continue
        for i, (stamp, times) in enumerate(zip(stamps, held, strict=True)):
            if stamp != times:
                yield Difference(None, f"{topic}[{i}]", f"stamped {stamp}, holds {times}")


def _result(log: TrialLog, result: Result) -> Iterator[Difference]:
    """The result follows from the poses and the steps."""
    verdict = result.verdict
    ours = Result.of(
        log.start.setup,
        verdict,
        outcome=result.outcome,
        reason=result.reason,
        duration_s=result.duration_s,
        solve_ns=tuple(step.solve_ns for step in log.steps),
        deadline_misses=sum(step.deadline_missed for step in log.steps),
    )
    for name, stated, found in (
        ("robot_errors", result.robot_errors, ours.robot_errors),
        ("total_error", result.total_error, ours.total_error),
    ):
        if not np.allclose(stated, found, rtol=1e-12, atol=0):
            yield Difference(None, f"result.{name}", f"states {stated}, the poses make it {found}")
    if log.damage is None:
        if (result.steps, result.solve_ns) != (ours.steps, ours.solve_ns):
            text = "steps and their timing are not those stated"
            yield Difference(None, "result.steps", text)
        if result.deadline_misses != ours.deadline_misses:
            text = f"states {result.deadline_misses}, the steps make it {ours.deadline_misses}"
            yield Difference(None, "result.deadline_misses", text)
        if not _stands(log, verdict.final):
            yield Difference(None, "result.final", "is not where the robots were seen last")
    yield from _ending(log, result)
    if log.damage is None and result.outcome.complete:
        yield from _rest(log)
    yield from _obstacles(log, verdict)


def _obstacles(log: TrialLog, verdict: Verdict) -> Iterator[Difference]:
    """The verdict follows from the path: what its samples show, the plant's samples show too.

    Only the lab's plant judges the logged frames themselves, from the first step on. A simulation
    judges more samples, so its clearance may be less; and a straight line between two of its frames
    may cut a corner that the true path goes round, so that only its samples count: `resimulate`
    checks the rest.
    """
    path, known = trial_path(log)
    shown = judged(log, path, known, verdict.final)
    for name in ("clearance", "edge", "apart"):
        pairs = zip(getattr(verdict, name), getattr(shown, name), strict=False)
        for i, (stated, least) in enumerate(pairs):
            room = REST * max(1.0, abs(least)) if np.isfinite(least) else 0.0
            if log.start.plant.simulated and stated > least + room:
                text = f"states {stated}, a frame shows {least}"
                yield Difference(None, f"result.{name}.{i}", text)
            seen = not log.start.plant.simulated and not log.damage and np.isfinite(least)
            if seen and stated < least - room:
                text = f"states {stated}, the nearest frame shows {least}"
                yield Difference(None, f"result.{name}.{i}", text)
    for i, (stated, least) in enumerate(zip(verdict.entered, verdict.clearance, strict=True)):
        if least < 0 and not stated:
            yield Difference(None, f"result.entered.{i}", f"false, with clearance {least}")
        elif shown.entered[i] and not stated and not log.start.plant.simulated:
            yield Difference(None, f"result.entered.{i}", "false, but the path touches an obstacle")
        elif stated and not (shown.entered[i] or log.start.plant.simulated or log.damage):
            yield Difference(None, f"result.entered.{i}", "true, but the path touches no obstacle")
    if not (log.start.plant.simulated or log.damage or log.stop is None):
        yield from _driven(log, verdict, path, known, log.stop)


def _driven(
    log: TrialLog, verdict: Verdict, path: Floats, known: Bools, stop: Command
) -> Iterator[Difference]:
    """The lab's plant judges at least the frames between the first step and the stop."""
    since = log.steps[0].command.sent_ns if log.steps else stop.sent_ns
    between = (log.received_ns > since) & (log.received_ns <= stop.sent_ns)
    shown = judged(log, path[between], known[between], verdict.final)
    for i, (stated, least) in enumerate(zip(verdict.clearance, shown.clearance, strict=True)):
        if stated > least + REST * max(1.0, abs(least)):
            text = f"states {stated}, a frame shows {least}"
            yield Difference(None, f"result.clearance.{i}", text)


def _ending(log: TrialLog, result: Result) -> Iterator[Difference]:
    stop = log.stop
    said = [note.text for note in log.notes]
    if said and result.summary not in said and not log.damage:
        yield Difference(None, "log", f"nothing on /log says {result.summary!r}")
    if stop is None:
        return
    if not log.start.plant.simulated and not log.damage:
        yield from _lasted(log, result, stop)
    if log.steps and stop.sent_ns < log.steps[-1].command.sent_ns:
        yield Difference(None, "stop.sent_ns", "the stop comes before the last step")
    if log.start.plant.simulated and result.duration_s != (took_s := log.elapsed_s(stop.sent_ns)):
        text = f"states {result.duration_s}, the stop was after {took_s}"
        yield Difference(None, "result.duration_s", text)
    if result.outcome is Outcome.ABORTED and not result.reason:
        yield Difference(None, "result.reason", "aborted without a reason")


def _rest(log: TrialLog) -> Iterator[Difference]:
    """The last frames of a complete lab trial show every robot, standing where it can."""
    lab, now = log.experiment.plant, log.mocap_ns
    if log.start.plant.simulated or not isinstance(lab, LabSection) or not len(now):
        return
    halts = log.start.plant.facts.get(HALTS) == "yes"  # logs of old do not tell
    for i, name in enumerate(log.start.setup.names):
        seen = np.flatnonzero(log.valid[:, i])
        unseen_s = seconds(int(now[-1] - (now[seen[-1]] if len(seen) else 0)))
        if unseen_s > SLACK * lab.limits.untracked_stop:
            text = f"complete, but {name} was not tracked for the last {unseen_s:.2f} s"
            yield Difference(None, "result.outcome", text)
            continue
        last = seen[now[seen] >= now[-1] - REST_NS]
        gone_mm = np.hypot(*(log.mocap[last[-1], i, :2] - log.mocap[last[0], i, :2]))
        gone_mm *= log.start.setup.metres / MM
        span_s = seconds(int(now[last[-1]] - now[last[0]]))
        if halts and gone_mm > SLACK * lab.limits.standstill_mm * span_s:
            text = f"complete, but {name} moved by {gone_mm:.0f} mm in the last {span_s:.2f} s"
            yield Difference(None, "result.outcome", text)


def _lasted(log: TrialLog, result: Result, stop: Command) -> Iterator[Difference]:
    """The duration in the lab begins after the first frame and before the first command."""
    first = min((command.sent_ns for command in log.commands), default=stop.sent_ns)
    opened = int(log.received_ns[0]) if len(log.received_ns) else 0
    least, most = seconds(stop.sent_ns - first), seconds(stop.sent_ns - min(opened, first))
    if not least - 1e-6 <= result.duration_s <= most + STOPPING_S:
        text = f"states {result.duration_s} s, the commands make it {least} to {most} s"
        yield Difference(None, "result.duration_s", text)


def _stands(log: TrialLog, final: Poses) -> bool:
    """Return whether the final poses are those of the last frames."""
    if log.truth is not None:
        return not len(log.truth) or bool(
            np.allclose(final.array(), log.truth[-1], rtol=REST, atol=REST)
        )
    if not len(log.mocap):
        return True
    ends: Sequence[bytes] = [
        np.ascontiguousarray(row).tobytes() for row in log.mocap[-LAST_FRAMES:]
    ]
    return np.ascontiguousarray(final.array()).tobytes() in ends
