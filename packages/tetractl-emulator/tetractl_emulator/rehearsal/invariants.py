"""What must hold on every day, whatever goes wrong: asserted on the truth, and on the log.

Each bound is derived in `docs/rehearsals.md` from tick, watchdog and stopping distance. The
observer knows the truth and shares no code with the guard.
"""

import math
import re
from collections.abc import Iterator

import numpy as np

from tetractl.experiment.lab_section import LabLimits
from tetractl.log.read.trial_log import TrialLog
from tetractl_emulator.rehearsal.depths import places
from tetractl_emulator.rehearsal.due import FRAME_S
from tetractl_emulator.rehearsal.log_checks import log_differences
from tetractl_emulator.rehearsal.logged import logged
from tetractl_emulator.rehearsal.schedule import MOTION
from tetractl_emulator.rehearsal.sending import sending
from tetractl_emulator.rehearsal.times import times
from tetractl_emulator.rehearsal.truth import Truth
from tetractl_emulator.rehearsal.violation import AIR_S, SLACK_S, Violation
from tetractl_emulator.rehearsal.world import LAG_MAX_S

ROLL_S = LAG_MAX_S * math.log(1000.0)  # from 1 m/s to 1 mm/s with the slowest wheels
BELIEF_MM, BELIEF_S = 60.0, 1.0
RESULT_MM = 10.0
CHECKED_S = 0.55  # time of the frames that are checked before a run, and a tick
RESTS_S = 0.3  # of robots after the reason that ended a run, before its process ends
LATE = ("late_radio", "overtaken_packets")
DAMAGED = re.compile(r"(\d+) damaged camera frames within a second")
ERROR = re.compile(r"\b[A-Z]\w*(Error|Exception|Interrupt)\b|Traceback")


def violations(truth: Truth, limits: LabLimits, watchdog_s: float) -> list[Violation]:
    """Return the invariants that a day has broken."""
    class_ = hidden(truth, limits)
    found = [*sending(truth, limits, watchdog_s), *_rest(truth, limits, watchdog_s), *ends(truth)]
    found += [*reasons(truth), *times(truth, limits.stale, limits.untracked_abort), *logged(truth)]
    found += [*places(truth, limits), *_begins(truth, limits)]
    beyond = [*_space(truth, limits, watchdog_s), *_belief(truth)]
    return found + [Violation(v.name, v.at_s, v.found, class_) for v in beyond]


def _late_s(truth: Truth) -> float:
    """Return by how much the radio was late."""
    return sum(fault["by"] for _, _, fault in truth.faults if fault["fault"] in LATE)


def _begins(truth: Truth, limits: LabLimits) -> Iterator[Violation]:
    """No run begins on frames that are older on arrival than the limit, which the check before a
    run sees in half a second of frames.
    """
    run = truth.first("run") if truth.dated else -np.inf
    for began, ended, fault in truth.faults:
        old = fault["fault"] == "late_frames" and fault["by"] > limits.latency + SLACK_S
        if old and began + fault["by"] + CHECKED_S < run < ended:
            yield Violation("begins blind", run, f"frames are {fault['by']:.2f} s old")


def _rest(truth: Truth, limits: LabLimits, watchdog_s: float) -> Iterator[Violation]:
    """Robots stand within a bound after the stop, after the last sight, and at the end."""
    bound = AIR_S + watchdog_s + ROLL_S + _late_s(truth)
    gone = [at for at, _, fault in truth.faults if fault.get("signal") == "KILL"]
    end = min([truth.ended_s, *gone])
    # ten stops over 200 ms: with a radio that loses all of them the watchdog counts from the last
    late = (truth.times > end + bound)[:, None] & (truth.driving > 1.5)
    bound += truth.repeats_s(limits.wheel_error)
    blind = truth.unseen > limits.stale + 0.05 + SLACK_S + bound
    for name, wrong in (("moves after stop", late), ("moves unseen", blind & (truth.driving > 5))):
        if wrong.any():
            row, i = np.argwhere(wrong)[0]
            yield Violation(name, float(truth.times[row]), truth.setup.names[i])


def _reach(truth: Truth, limits: LabLimits, watchdog_s: float) -> float:
    """Return how long a robot may go on towards what it must not meet, beyond the time that the
    guard looks ahead [s].
    """
    after = limits.stale + 0.05 + SLACK_S + AIR_S + LAG_MAX_S + _late_s(truth)
    quiet = ("loss", "deaf", "unplug", "stuck_port", "radio_resets", "baud", "bad_bytes", "signal")
    if truth.met(*quiet, "stopped", "off", "busy"):
        after += watchdog_s
    return max(0.0, after - limits.reaction)


def _space(truth: Truth, limits: LabLimits, watchdog_s: float) -> Iterator[Violation]:
    """No robot beyond the rim or in an obstacle by more than its pose was wrong, people moved it,
    and it rolled before it could be stopped.
    """
    moved = [math.hypot(*f["by"]) for _, _, f in truth.faults if f["fault"] == "pushed"]
    if not len(truth.times):
        return
    wrong = np.maximum.accumulate(truth.error, axis=0)
    speed = np.maximum.accumulate(truth.driving, axis=0)
    allowed = wrong + sum(moved) + speed * _reach(truth, limits, watchdog_s) + 2.0
    beyond = truth.depth - allowed
    if (beyond > 0).any():
        row, i = np.unravel_index(int(beyond.argmax()), beyond.shape)
        found = f"{truth.setup.names[i]} by {truth.depth[row, i]:.0f} mm, allowed "
        yield Violation("enters", float(truth.times[row]), f"{found}{allowed[row, i]:.0f} mm")


def _belief(truth: Truth) -> Iterator[Violation]:
    """No pose accepted far from the truth for long while robots drive; a result is true."""
    far = (truth.error > BELIEF_MM) & (truth.driving > 5)
    for i, name in enumerate(truth.setup.names):
        rows = np.flatnonzero(far[:, i])
        for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if len(rows) else ():
            if truth.times[run[-1]] - truth.times[run[0]] > BELIEF_S:
                most = truth.error[run, i].max()
                found = f"{name} by {most:.0f} mm"
                yield Violation("accepts wrong", float(truth.times[run[-1]]), found)
                return
    if isinstance(truth.log, TrialLog) and truth.log.result and truth.log.result.outcome.complete:
        mm = truth.setup.metres * 1000
        apart = truth.poses[truth.final, :, :2] / mm - truth.setup.targets.reshape(-1, 2)
        off = np.hypot(apart[:, 0], apart[:, 1]) - truth.log.result.robot_errors
        if (most := float(np.abs(off).max()) * mm) > RESULT_MM:
            yield Violation("wrong result", float(truth.times[-1]), f"by {most:.0f} mm")


def ends(truth: Truth) -> Iterator[Violation]:
    """Log, exit code and what is left behind."""
    day, log = truth.day, truth.log
    killed = truth.killed
    expected = -9 if killed and day.exit < 0 else 1
    if ERROR.search(day.said) or ERROR.search(truth.reason):
        text = truth.reason if ERROR.search(truth.reason) else day.said
        yield Violation("exception", 0.0, text[-500:])
    if day.exit == -100:
        yield Violation("hangs", 0.0, "")
        return
    if day.left:
        yield Violation("left behind", 0.0, day.left)
    if isinstance(log, str):
        if log or truth.began_s < np.inf:
            yield Violation("no log", 0.0, log or "none was written")
    elif log.result is None:
        expected = -9 if killed else 1
        if not killed and not truth.met("disk_full"):
            yield Violation("no result", 0.0, str(log.damage))
    else:
        outcome = log.result.outcome
        expected = 0 if outcome.complete else 130 if outcome == "interrupted" else 1
        assert day.log is not None, "it was read"
        if log.damage is None and (differs := [*log_differences(log)]):
            yield Violation("verify", 0.0, str(differs[0]))
        elif log.damage is not None and not truth.met("disk_full"):
            yield Violation("damaged log", 0.0, str(log.damage))
    refused = truth.began_s == np.inf and truth.met("signal")  # while it waits for robots
    if day.exit != expected and not (refused and day.exit == 130):
        yield Violation("exit code", 0.0, f"{day.exit}, not {expected}")


def reasons(truth: Truth) -> Iterator[Violation]:
    """The reason names a fault that was there."""
    reason = truth.reason
    if reason and not truth.day.plan.faults:
        yield Violation("false alarm", min(truth.abort_s, 1e6), reason[:200])
        return
    spoilt = sum(f["share"] for _, _, f in truth.faults if f["fault"] == "bad_datagrams") / FRAME_S
    most = spoilt + 6.0 * math.sqrt(spoilt)  # in a second, but for one case in a billion
    all_damaged = truth.met("other_version")
    if (count := DAMAGED.match(reason)) and 0 < most < int(count[1]) and not all_damaged:
        yield Violation("reason", truth.abort_s, f"{reason}: {spoilt:.0f} a second were")
    if other := _misnamed(truth):
        yield Violation("reason", min(truth.abort_s, 1e6), f"{reason[:200]}: it was {other}")
    grid = MOTION if truth.setup.sight.coarse and truth.met("freeze") else ""
    right = [
        truth.day.plan.right,
        grid,
        *(truth.day.plan.kind(f).right for _, _, f in truth.faults),
    ]
    if reason and not re.search("|".join(filter(None, right)) or "$.", reason, re.IGNORECASE):
        yield Violation("reason", min(truth.abort_s, 1e6), reason[:200])


def _misnamed(truth: Truth) -> str:
    """Return the robot that has the only fault, if the reason names others; "" if it does not."""
    natural = re.search(truth.day.plan.right or "$.", truth.reason)
    if len(truth.faults) != 1 or natural or "robot" not in truth.faults[0][2]:
        return ""
    (_, _, fault) = truth.faults[0]
    named = {name for name in truth.setup.names if re.search(rf"\b{name}\b", truth.reason)}
    return str(fault["robot"]) if named and not named & {fault["robot"], fault.get("other")} else ""


def hidden(truth: Truth, limits: LabLimits) -> str:
    """Return the class of faults on the day that one camera cannot tell from wheels within
    `wheel_error`, by the derivation; "" for none.
    """
    speed = float(truth.setup.speed.max()) * truth.setup.metres * 1000
    radius = (truth.setup.wheel_radius or 0.04) * truth.setup.metres * 1000
    turn, walk = limits.wheel_error * speed / radius, limits.wheel_error * speed + 5.0
    for _, _, fault in truth.faults:
        step = math.hypot(*fault.get("by", ())) if isinstance(fault.get("by"), list) else 0.0
        slow = fault["fault"] == "ghost" or (fault["fault"] == "picture" and fault.get("creeps"))
        rate, speed_mm = abs(fault.get("turn", 0.0)) * 120, step * 120
        grows = abs(fault.get("scale", 1.0) - 1.0) * 120 * 1000
        if slow and rate <= turn and speed_mm <= walk and grows <= walk:
            return "slow: as wheels within wheel_error"
    return ""
