"""The seven sentences that hold on every day of robots, each with one bound.

| sentence | bound | from |
|---|---|---|
| no robot is driven blind | `stale` + `reaction` after its last sight | limits of the spec |
| robots rest after a stop | air + `watchdog` + rolling [s] | UART and radio, wheels, `ROLL_S` |
| robots stay inside the arena, apart | speed * (sight + air + lag - `reaction`) [mm] | stopping |
| poses and the result are true | `POSE_MM`, `POSE_RAD`; `RESULT_MM` | a body; noise at rest |
| the log is readable, and says what was | `NOTED_S` of `logged` | poll of the wire |
| the exit code is right | 0, 1, 130, or the signal's | documentation of the codes |
| the reason names a fault that was there | the row of the table of faults | `schedule` |

Distances are in mm and times in s. The observer knows the truth and shares no code with the guard.
"""

import math
import re
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations, islice
from typing import NamedTuple

import numpy as np

from tetractl.core.commands import Stop
from tetractl.core.plan import Outcome
from tetractl.core.poses import Floats
from tetractl.log.read.trial_log import TrialLog
from tetractl_emulator.rehearsal.day import HUNG
from tetractl_emulator.rehearsal.log_checks import log_differences
from tetractl_emulator.rehearsal.logged import MUTE, logged
from tetractl_emulator.rehearsal.schedule import FRAME_S, MOTION
from tetractl_emulator.rehearsal.truth import (
    EMERGENCY,
    LATCHED,
    MOVES_MM_S,
    RUNNING,
    SILENT,
    Truth,
    time_s,
)
from tetractl_emulator.rehearsal.violation import Violation
from tetractl_emulator.rehearsal.world import LAG_MAX_S

Sentence = Callable[[Truth], Iterator[Violation]]

AIR_S = 0.05  # a tick of 10 ms, a frame of the camera, the UART and the air
ROLL_S = LAG_MAX_S * math.log(1000.0)  # from 1 m/s to 1 mm/s with the slowest wheels
NOISE_MM = 4.0  # of a camera at its worst
TILT_NOISE = 0.05  # of the tilt that a camera at its worst measures [rad]
DRIVEN_MM_S = 5.0  # least speed of a wheel of a robot that is driven
TURNS_MM_S = 1.5  # least speed at which a wheel counts as turning: it has rolled to 1 mm/s
WATCHED_S = 4.0  # in which a robot crosses half the arena
STOPS = 5  # a radio that loses every second packet takes one of these on 97 of 100 days
POSE_MM = 95.0  # a body's length
POSE_RAD = 1.0  # the turn by which a robot leaves its way
RESULT_MM = 10.0  # 0.03 s of driving at 200 mm/s, and the noise of poses at rest
RESTS_S = 1.0  # of pictures that show whether robots rest
SHOWN_S = NOISE_MM / MOVES_MM_S  # in which the slowest motion that counts is more than noise
EVENT_S = 0.03  # longest time for which a reading of a mat waits for an event of its connection
LATE_RADIO = ("late_radio", "overtaken_packets")
OFF_FLOOR = ("lifted", "tipped")
ERROR = re.compile(r"\b[A-Z]\w*(Error|Exception|Interrupt)\b|Traceback")


def violations(truth: Truth) -> list[Violation]:
    """Return the sentences that a day of robots has broken."""
    return [violation for sentence in SENTENCES for violation in sentence(truth)]


# 1


def driven_blind(truth: Truth) -> Iterator[Violation]:
    """No robot is driven that has not been shown for `stale`, none while another has not been shown
    for `untracked_abort`, none without a direction for `stream_lost`: by more than `reaction` each.
    """
    limits = truth.limits
    own_s = limits.stale + limits.reaction + truth.late_s
    other_s = limits.untracked_abort + limits.reaction + truth.late_s
    silent_s = max(limits.stream_lost, (limits.late_steps + 1) * truth.setup.period_s)
    silent_s += limits.reaction
    mute = truth.met(*MUTE) or truth.killed
    off_floor = [span for span in hidden_spans(truth) if span.fault in OFF_FLOOR]
    for k, command in enumerate(truth.commands):
        driven = np.array(truth.drives(command), bool)
        if not driven.any():
            continue
        acts_s = 0.0 if mute else truth.acting_s[k]
        unseen = np.array(command["unseen_ms"]) / 1000 + acts_s
        at_s = time_s(command)
        for span in off_floor:  # the camera tracks the body, and shows no robot
            if span.began_s < at_s < span.ended_s:
                unseen[span.robot] = max(unseen[span.robot], at_s + acts_s - span.began_s)
        finding = ""
        if unseen[driven].max() > own_s or unseen.max() > other_s:
            finding = f"unseen for {unseen.max():.3f} s"
        elif truth.undirected_s[k] > silent_s and not mute:
            finding = f"without a direction for {truth.undirected_s[k]:.2f} s"
        if finding:
            yield Violation("driven blind", at_s, finding, frozen(truth))
            return
    yield from _seldom_shown(truth)


def _seldom_shown(truth: Truth) -> Iterator[Violation]:
    """In each `WATCHED_S` in which robots may be driven, each is shown for half of it, though late:
    how old a pose may be by which a robot is driven is said above.
    """
    span_s = np.diff(truth.times_s, append=truth.alive_s).clip(0.0, FRAME_S * 2)
    may_drive = np.zeros(len(truth.times_s), bool)
    for span in truth.driven_spans:
        may_drive |= (truth.times_s >= span.began_s) & (truth.times_s < span.ended_s)
    span_s = np.where(may_drive, span_s, 0.0)
    driven_s = np.cumsum(span_s)
    blind = truth.unseen_s > truth.limits.stale + truth.longest_delay_s
    blind_s = np.cumsum(np.where(blind, span_s[:, None], 0.0), axis=0)
    before = np.searchsorted(driven_s, driven_s - WATCHED_S)
    much = (blind_s - blind_s[before]).max(axis=1, initial=0.0) > WATCHED_S / 2
    if much.any():
        at_s = float(truth.times_s[much.argmax()])
        finding = f"a robot is unseen for half of {WATCHED_S:g} s"
        yield Violation("driven blind", at_s, finding, frozen(truth))


# 2


def rests_after_a_stop(truth: Truth) -> Iterator[Violation]:
    """After the end none is driven for more than a tick, all stand, stops are sent, and an
    emergency stop stays; a run begins at rest.
    """
    end_s = truth.ended_s
    killed_s = [fault.span.began_s for fault in truth.faults if fault.is_kill]
    bound_s = AIR_S + truth.watchdog_s + ROLL_S + _radio_late_s(truth)
    must_rest = truth.times_s > min([end_s, *killed_s]) + bound_s
    rolls = must_rest[:, None] & (truth.wheel_speed_mm_s > TURNS_MM_S)
    if rolls.any():
        row, i = np.argwhere(rolls)[0]
        yield _unrest(float(truth.times_s[row]), f"{truth.setup.names[i]} moves")
    for command, acts_s in zip(truth.commands, truth.acting_s.tolist(), strict=True):
        if time_s(command) > end_s and acts_s > AIR_S and any(truth.drives(command)):
            yield _unrest(time_s(command), "a command drives")
            break
    yield from _emergency(truth)
    yield from _obeys(truth)
    if not truth.met(*MUTE) and not truth.killed:
        yield from _stops(truth)
    begins_s = truth.first_s("run")
    shown_s = SHOWN_S + truth.limits.latency + AIR_S
    for fault in truth.shown_moving:
        if fault.span.began_s + shown_s < begins_s < fault.span.ended_s:
            yield _unrest(begins_s, f"a run begins though the camera shows motion: {fault.kind}")


def _unrest(at_s: float, finding: str) -> Violation:
    return Violation("not at rest", float(at_s), finding)


def _radio_late_s(truth: Truth) -> float:
    """Return by how much faults of the radio delay what is sent [s]."""
    return truth.delay_s(*LATE_RADIO)


def _emergency(truth: Truth) -> Iterator[Violation]:
    """An emergency stop is sent as soon as it is pressed, each later command has its flag, and no
    robot that has latched is free again before it is switched off.
    """
    pressed_s = truth.first_s("fault", name="emergency", phase="start")
    commands = [(time_s(c), bool(c["flags"] & EMERGENCY)) for c in truth.commands]
    if truth.first_s("run") < pressed_s < truth.alive_s - AIR_S and not truth.met(*MUTE):
        if not any(pressed_s - AIR_S < at_s < pressed_s + AIR_S for at_s, flag in commands if flag):
            yield _unrest(pressed_s, "no emergency stop is sent")
        if any(at_s > pressed_s + AIR_S for at_s, flag in commands if not flag):
            yield _unrest(pressed_s, "a command releases the emergency stop")
    latched = truth.has_status(LATCHED)
    freed = latched[:-1] & ~latched[1:]
    if freed.any() and not truth.met("off"):
        yield _unrest(truth.times_s[freed.any(axis=1).argmax()], "a robot is free again")


def _obeys(truth: Truth) -> Iterator[Violation]:
    """A robot that has stood after the end is not driven again, by a command that another has
    overtaken. A radio that delays all alike delays the end, too.
    """
    heard_s = truth.ended_s + AIR_S + truth.delay_s("late_radio")
    runs = truth.has_status(RUNNING)
    after = (truth.times_s > heard_s)[:, None]
    stood = np.maximum.accumulate(after & ~runs & ~truth.has_status(SILENT), axis=0)
    again = (stood & runs).any(axis=1)
    if again.any() and not truth.met("off"):
        yield _unrest(truth.times_s[again.argmax()], "a robot is driven again")


def _stops(truth: Truth) -> Iterator[Violation]:
    """Stops follow the end of each run, as many as a radio that loses some needs."""
    halts = [time_s(c) for c in truth.commands if not any(truth.drives(c))]
    for span in truth.driven_spans:
        end_s = span.ended_s
        sent = sum(end_s - AIR_S < at_s < end_s + truth.watchdog_s for at_s in halts)
        if sent < STOPS and end_s + truth.watchdog_s < truth.alive_s:
            yield _unrest(end_s, f"{sent} stops are sent")
            return
    # while one robot is not shown, it is not known to rest
    again_s = truth.ended_s + RESTS_S
    rows = (truth.times_s > truth.ended_s) & (truth.times_s < again_s)
    apart_s = np.ptp(truth.unseen_s[rows], axis=1) if rows.any() else np.zeros(1)
    ends = max(halts, default=0.0) < truth.ended_s + 2 * truth.watchdog_s
    if ends and apart_s.min() > truth.watchdog_s and again_s < truth.alive_s:
        yield _unrest(again_s, "stops end though a robot is not shown")


# 3


def stays_inside(truth: Truth) -> Iterator[Violation]:
    """No robot is beyond the rim, in an obstacle, or nearer to another than `separation_mm`, by
    more than its pose was wrong, people moved it, and it rolled before it could be stopped.
    """
    if not len(truth.times_s):
        return
    speed = np.maximum.accumulate(truth.wheel_speed_mm_s, axis=0)
    wrong = np.maximum.accumulate(truth.error_mm, axis=0)
    allowed = wrong + speed * _rolls_s(truth) + NOISE_MM / 2
    names = truth.setup.names
    yield from _outside(truth, truth.outside_mm - allowed - _pushed_mm(truth), names)
    robots = range(len(names))
    pairs = list(combinations(robots, 2))
    if pairs:
        positions = truth.poses[..., 0] + 1j * truth.poses[..., 1]
        meets = [
            truth.limits.separation_mm
            - np.abs(positions[:, i] - positions[:, j])
            - allowed[:, i]
            - allowed[:, j]
            for i, j in pairs
        ]
        pair_names = [f"{names[i]}, {names[j]}" for i, j in pairs]
        yield from _outside(truth, np.stack(meets, axis=1) - _pushed_mm(truth), pair_names)


def _pushed_mm(truth: Truth) -> float:
    """Return how far people moved robots, which no frame shows at once."""
    return sum(math.hypot(*fault.fields["by"]) for fault in truth.faults_of("pushed"))


def _pushed_rad(truth: Truth) -> float:
    """Return by how much people turned robots, which no frame shows at once."""
    return sum(abs(fault.fields.get("turn", 0.0)) for fault in truth.faults_of("pushed"))


def _rolls_s(truth: Truth) -> Floats:
    """Return how long a robot may go on beyond the time that is looked ahead (T, N) [s]: since it
    was last shown, the way of a stop to it, and its lag.
    """
    after_s = AIR_S + LAG_MAX_S + _radio_late_s(truth)
    quiet = ("loss", "deaf", "unplug", "stuck_port", "radio_resets", "baud", "bad_bytes", "signal")
    if truth.met(*quiet, "stopped", "off", "busy"):
        after_s += truth.watchdog_s
    unseen_s = np.where(truth.wheel_speed_mm_s > DRIVEN_MM_S, truth.unseen_s, 0.0)
    unseen_s = np.maximum.accumulate(unseen_s, axis=0) + truth.late_s
    return np.maximum(0.0, unseen_s + after_s - truth.limits.reaction)


def _outside(truth: Truth, beyond: Floats, names: Sequence[str]) -> Iterator[Violation]:
    if (beyond > 0).any():
        row, i = np.unravel_index(int(beyond.argmax()), beyond.shape)
        finding = f"{names[int(i)]} by {beyond[row, i]:.0f} mm more than allowed"
        yield Violation("outside", float(truth.times_s[row]), finding, hidden(truth))


# 4


def poses_are_true(truth: Truth) -> Iterator[Violation]:
    """No pose is accepted of a robot that is driven that is off by more than a body; none of one
    that is hidden; and the errors of a complete trial are true.

    A pose is compared where it was exposed: what a robot does until the next one is its own motion.
    """
    accepted = (
        truth.fresh & (truth.wheel_speed_mm_s > 5.0) & (truth.times_s < truth.ended_s)[:, None]
    )
    off_mm, off_rad = _least_off(truth)
    off_mm -= _pushed_mm(truth)
    off_rad -= _pushed_rad(truth)
    for off, most, unit in ((off_mm, POSE_MM, "mm"), (off_rad, POSE_RAD, "rad")):
        wrong = accepted & (off > most)
        if wrong.any():
            row, i = np.argwhere(wrong)[0]
            finding = f"{truth.setup.names[i]} by {off[row, i]:.3g} {unit}"
            yield Violation("untrue", float(truth.times_s[row]), finding, hidden(truth))
            break
    yield from _seen_though_hidden(truth)
    log = truth.trial
    if log is not None and log.result is not None and log.result.outcome.complete:
        most_mm = float(_result_off_mm(truth, log.result.robot_errors).max())
        if most_mm > RESULT_MM:
            finding = f"a result by {most_mm:.0f} mm"
            yield Violation("untrue", float(truth.times_s[-1]), finding, hidden(truth))


def _result_off_mm(truth: Truth, robot_errors: Sequence[float]) -> Floats:
    """Return how far the error of each robot in a result is (N,) from the nearest true one [mm] of
    the last `stale`: a robot that is put elsewhere at the end is known by its pose before.
    """
    mm = truth.setup.metres * 1000
    final_s = truth.times_s[truth.final_exposure]
    is_recent = (truth.times_s > final_s - truth.limits.stale) & (truth.times_s <= final_s)
    apart = truth.poses[is_recent, :, :2] / mm - truth.setup.targets.reshape(-1, 2)
    off = np.hypot(apart[..., 0], apart[..., 1]) - robot_errors
    return np.abs(off).min(axis=0) * mm


def _least_off(truth: Truth) -> tuple[Floats, Floats]:
    """Return how far each pose accepted is, in place [mm] and in heading [rad] (T, N), from the
    nearest true one of the time in which it may have been exposed: the `late_s` and, if it repeats
    the pose before to the last bit, the time in which a frozen pose looks like that of a
    robot that stands, since a stop or no command may still act on it.
    """
    frozen_s = truth.limits.stale + AIR_S + truth.watchdog_s
    within_s = truth.late_s + np.where(truth.repeated, frozen_s, 0.0)
    last = np.arange(len(truth.times_s))[:, None]
    first = np.searchsorted(truth.times_s, truth.times_s[:, None] - within_s)
    robots = np.arange(truth.fresh.shape[1])
    least_mm = np.full(truth.fresh.shape, np.inf)
    least_rad = least_mm.copy()
    for back in range(int((last - first).max(initial=0)) + 1):
        off = truth.accepted - truth.poses[np.maximum(last - back, first), robots]
        turned = np.abs(np.remainder(off[..., 2] + np.pi, 2 * np.pi) - np.pi)
        least_mm = np.fmin(least_mm, np.hypot(off[..., 0], off[..., 1]))
        least_rad = np.fmin(least_rad, turned)
    return least_mm, least_rad


def _seen_though_hidden(truth: Truth) -> Iterator[Violation]:
    """Yield a robot of which the log has a pose, though it was hidden or not on the floor.

    Readings of a mat have the times of their arrival: one may be from before its robot was hidden.
    """
    arrives_s = EVENT_S if truth.setup.sight.coarse else 2 * FRAME_S
    for span in hidden_spans(truth):
        began_s = span.began_s + arrives_s
        ended_s = span.ended_s - 2 * FRAME_S
        during = (truth.times_s > began_s) & (truth.times_s < ended_s)
        is_shown = during & truth.fresh[:, span.robot]
        if is_shown.any():
            name = truth.setup.names[span.robot]
            yield Violation(
                "untrue", float(truth.times_s[is_shown.argmax()]), f"{name} is not hidden"
            )
            return


class HiddenSpan(NamedTuple):
    """A time in which a fault hides a robot, or its body is not on the floor: begin, end [s]."""

    robot: int
    fault: str
    began_s: float
    ended_s: float


def hidden_spans(truth: Truth) -> Iterator[HiddenSpan]:
    """Yield when robots were hidden, or lifted or tipped by more than the spec allows; nothing if
    robots are swapped: each is then shown where another is.
    """
    if truth.met("swap"):
        return
    limits = truth.limits
    for fault in truth.faults:
        fields = fault.fields
        high = fields.get("height", 0.0) > limits.height_mm[1] + NOISE_MM
        tilted = fault.name == "tipped" and abs(fields["angle"]) > limits.tilt + TILT_NOISE
        if fault.name in ("untracked", "nan", "bad_quaternion") or high or tilted:
            robot = truth.setup.names.index(fields["robot"])
            yield HiddenSpan(robot, fault.name, fault.span.began_s, fault.span.ended_s)


def hidden(truth: Truth) -> str:
    """Return the class of faults on the day that one camera cannot show: those that it cannot tell
    from wheels within `wheel_error`, and a picture that crept before the run, since all poses are
    measured in it; "" for none.
    """
    error = truth.limits.wheel_error
    speed = float(truth.setup.speed.max()) * truth.setup.metres * 1000
    radius = (truth.setup.wheel_radius or 0.04) * truth.setup.metres * 1000
    walk = error * speed + 5.0
    for fault in truth.faults_of("ghost", "picture"):
        fields = fault.fields
        creeps = fault.name == "ghost" or fields.get("creeps")
        step_mm = math.hypot(*fields.get("by", (0.0, 0.0)))
        speed_mm_s = step_mm / FRAME_S
        rate = abs(fields.get("turn", 0.0)) / FRAME_S
        grows = abs(fields.get("scale", 1.0) - 1.0) / FRAME_S * 1000
        if creeps and rate <= error * speed / radius and speed_mm_s <= walk and grows <= walk:
            return "slow: as wheels within wheel_error"
        if fault.name == "picture" and creeps and fault.span.ended_s <= truth.began_s:
            return "before: the camera was off when the run began"
    return ""


def frozen(truth: Truth) -> str:
    """Return the class of frozen pictures that a camera's grid hides: those of robots that stand;
    "" for none.
    """
    coarse = truth.setup.sight.coarse and truth.met("repeat", "freeze")
    return "frozen: as robots that stand" if coarse else ""


# 5


def log_is_readable(truth: Truth) -> Iterator[Violation]:
    """A log is there, whole but for a full disk or a kill, consistent, and says what was."""
    yield from log_is_whole(truth)
    yield from logged(truth)


def log_is_whole(truth: Truth) -> Iterator[Violation]:
    """A log is there, whole but for a full disk or a kill, and consistent."""
    log = truth.log
    spoilt = truth.killed or truth.met("disk_full")
    if truth.day.exit == HUNG:
        return
    if isinstance(log, str):
        if log or truth.began_s < np.inf:
            yield Violation("log", 0.0, log or "none was written")
    elif log.result is None or log.damage is not None:
        if not spoilt:
            yield Violation("log", 0.0, f"damaged, or without a result: {log.damage}")
    else:
        for differs in islice(log_differences(log), 1):
            yield Violation("log", 0.0, str(differs))


# 6


def exit_code_is_right(truth: Truth) -> Iterator[Violation]:
    """The exit code says how the trial ended, nothing is left behind, and a trial counts only if
    robots were seen to rest, no emergency stop was pressed and no limit of the spec was passed.
    """
    day = truth.day
    log = truth.log
    for text in (truth.reason, day.said):
        if ERROR.search(text):
            yield _exit(text[-500:])
            break
    if day.exit == HUNG:
        yield _exit("hangs")
        return
    if day.left_behind:
        yield _exit(f"left behind: {day.left_behind}")
    expected = -9 if truth.killed and day.exit < 0 else 1
    if isinstance(log, TrialLog) and log.result is not None:
        outcome = log.result.outcome
        expected = exit_code_of(outcome)
    refused = truth.began_s == np.inf and truth.met("signal")  # while it waits for robots
    if day.exit != expected and not (refused and day.exit == 130):
        yield _exit(f"{day.exit}, not {expected}")
    if day.exit == 0:
        yield from _counts(truth)


def exit_code_of(outcome: Outcome) -> int:
    """Return the exit code of a run of one trial that ended so, as the documentation says."""
    if outcome.complete:
        return 0
    return 130 if outcome is Outcome.INTERRUPTED else 1


def _exit(finding: str, at_s: float = 0.0) -> Violation:
    return Violation("exit code", at_s, finding)


def _counts(truth: Truth) -> Iterator[Violation]:
    end_s = truth.alive_s
    pressed_s = truth.first_s("fault", name="emergency", phase="start")
    if truth.first_s("run") < pressed_s < end_s - AIR_S:
        yield _exit("a trial counts though an emergency stop was pressed", pressed_s)
    is_before_end = truth.times_s <= end_s
    last = truth.unseen_s[is_before_end][-1:]
    if last.size and last.max() > truth.limits.stream_lost:
        finding = f"a trial counts though a robot was unseen for {last.max():.2f} s"
        yield Violation("exit code", end_s, finding, frozen(truth))
    for fault in truth.shown_moving:
        if fault.span.began_s < truth.ended_s + AIR_S and fault.span.ended_s > end_s:
            yield _exit(f"a trial counts though the camera shows motion: {fault.kind}", end_s)
    if truth.trial is not None and _late_in_a_row(truth) > truth.limits.late_steps:
        yield _exit("a trial counts though more than `late_steps` were late in a row")


def _late_in_a_row(truth: Truth) -> int:
    """Return the most control steps in a row that the log shows to be late by a period.

    A step begins when its frame has come and the step before has ended: a silent camera makes
    frames old, and no step late. Robots stand from a step that stops them until the next has ended:
    neither is late for anybody, and a row ends with them.
    """
    assert truth.trial is not None
    period_ns = truth.setup.period_s * 1e9
    most = 0
    count = 0
    ended_ns = 0
    robots_stand = True
    for step in truth.trial.steps:
        began_ns = max(step.observation.received_ns, ended_ns)
        ended_ns = step.command.sent_ns
        stops = isinstance(step.command.action, Stop)
        is_late = ended_ns - began_ns > period_ns
        in_row = is_late and not stops and not robots_stand
        count = count + 1 if in_row else 0
        robots_stand = stops
        most = max(most, count)
    return most


# 7


def reason_names_a_fault(truth: Truth) -> Iterator[Violation]:
    """The reason of an abort or a refusal is one that the table of faults has for a fault that was
    there, and names a robot that has it.
    """
    reason = truth.reason
    if not reason:
        return
    at_s = min(truth.abort_s, 1e6)
    plan = truth.day.plan
    grid = MOTION if truth.setup.sight.coarse and truth.met("freeze") else ""
    of_faults = [plan.kind(fault.fields).right for fault in truth.faults]
    right = [pattern for pattern in (plan.right, grid, *of_faults) if pattern]
    is_right = bool(right) and re.search("|".join(right), reason, re.IGNORECASE)
    if not plan.faults or not is_right:
        yield Violation("reason", at_s, reason[:200])
        return
    robot = _misnamed(truth)
    if robot:
        yield Violation("reason", at_s, f"{reason[:200]}: it was {robot}")


def _misnamed(truth: Truth) -> str:
    """Return the robot that has the only fault, if the reason names others; "" if it does not."""
    right = truth.day.plan.right
    needs_no_fault = bool(right) and re.search(right, truth.reason)
    if len(truth.faults) != 1 or needs_no_fault or "robot" not in truth.faults[0].fields:
        return ""
    fields = truth.faults[0].fields
    named = {name for name in truth.setup.names if re.search(rf"\b{name}\b", truth.reason)}
    has_fault = {fields["robot"], fields.get("other")}
    return str(fields["robot"]) if named and not named & has_fault else ""


SENTENCES: tuple[Sentence, ...] = (
    driven_blind,
    rests_after_a_stop,
    stays_inside,
    poses_are_true,
    log_is_readable,
    exit_code_is_right,
    reason_names_a_fault,
)
