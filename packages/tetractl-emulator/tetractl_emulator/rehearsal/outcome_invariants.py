"""The three invariants about the result of a trial: its log, exit code, and abort reason.

They hold for robots and for cells.
"""

import re
from collections.abc import Iterator
from itertools import islice

import numpy as np

from tetractl.core.commands import Stop, Turn
from tetractl.core.plan import Outcome
from tetractl.verification.result_check import result_differences
from tetractl_emulator.fault_rows import MOTION_REASONS, PLACE_REASONS
from tetractl_emulator.rehearsal.day import HUNG
from tetractl_emulator.rehearsal.logged import logged
from tetractl_emulator.rehearsal.truth import TRANSIT_S, Truth, Violation

KILLED = -9
"""The exit code of a test run whose process was killed."""
INTERRUPTED = 130
"""The exit code of a run that a signal has ended."""
NO_ABORT_S = 1e6
"""Time that is reported for an abort that never came [s].

It is finite because results contain no infinite numbers.
"""
PROGRAM_ERROR = re.compile(r"\b[A-Z]\w*(Error|Exception|Interrupt)\b|Traceback")
"""Pattern of the text that a run prints if it fails by an error of our program."""


def outcome_violations(truth: Truth) -> list[Violation]:
    """List the violations in a test run with cells: of the log, exit code and reason of an abort.

    Cells swim on when the field is off, so the invariants about standstill and places do not apply.
    """
    invariants = (log_is_whole, exit_code_is_right, reason_names_a_fault)
    return [violation for invariant in invariants for violation in invariant(truth)]


# The log is readable, and agrees with what happened


def log_is_readable(truth: Truth) -> Iterator[Violation]:
    """Yield each violation by a log that is incomplete or contradicts what happened.

    The checks are `log_is_whole` and `logged`.
    """
    yield from log_is_whole(truth)
    yield from logged(truth)


def log_is_whole(truth: Truth) -> Iterator[Violation]:
    """Check that there is a complete log once a run has begun.

    The log must be readable, have a result and no damage, and not contradict itself. The first
    contradiction is reported. In a test run with a full disk or a kill, the log may be damaged or
    lack its result, but it must exist and be readable. It is not checked if the run hangs.
    """
    if truth.day.exit_code == HUNG:
        return
    log = truth.log
    may_be_damaged = truth.was_killed or truth.had_fault("disk_full")
    if isinstance(log, str):
        if log or truth.steering_began_s < np.inf:
            yield Violation("log", 0.0, log or "none was written")
    elif log.result is None or log.damage is not None:
        if not may_be_damaged:
            yield Violation("log", 0.0, f"the log is damaged or has no result: {log.damage}")
    elif log.stop is None:
        yield Violation("log", 0.0, "has no stop")
    else:
        for difference in islice(result_differences(log, log.result), 1):
            yield Violation("log", 0.0, str(difference))


# The exit code is right


def exit_code_is_right(truth: Truth) -> Iterator[Violation]:
    """Check that a run ends properly and with the right exit code.

    A run must not hang, print an error of our program, or leave anything behind. It must end with
    the code of `_expected_code`, at the latest after `late_steps` late steps in a row. A trial may
    end with 0 only if `_check_valid_trial` allows it. If a process received a signal while it
    waited for robots, so that no run began, it may also end with 130. After a run that hangs,
    nothing else is checked.
    """
    day = truth.day
    for printed in (truth.reason, day.output):
        if PROGRAM_ERROR.search(printed):
            yield _exit_violation(printed[-500:])
            break
    if day.exit_code == HUNG:
        yield _exit_violation("hangs")
        return
    if day.left_behind:
        yield _exit_violation(f"left behind: {day.left_behind}")
    expected = _expected_code(truth)
    never_began = truth.steering_began_s == np.inf and truth.had_fault("signal")
    if day.exit_code != expected and not (never_began and day.exit_code == INTERRUPTED):
        yield _exit_violation(f"{day.exit_code}, not {expected}")
    if truth.trial is not None and _longest_late_run(truth) > truth.limits.late_steps:
        yield _exit_violation(
            "a trial goes on although more than `late_steps` control steps in a row were late"
        )
    if day.exit_code == 0:
        yield from _check_valid_trial(truth)


def _exit_violation(finding: str, at_s: float = 0.0) -> Violation:
    """Create a violation of the invariant on exit codes, at a time [s]."""
    return Violation("exit code", at_s, finding)


def _expected_code(truth: Truth) -> int:
    """Determine the exit code that a test run must have.

    It follows from the result in the log. Without a result, it is -9 if the process was killed, and
    otherwise 1. A kill cannot come after the result, because a kill acts in a tick of the
    emulation, and the log gets its result after the last tick.
    """
    if truth.trial is None or truth.trial.result is None:
        return KILLED if truth.was_killed and truth.day.exit_code < 0 else 1
    outcome = truth.trial.result.outcome
    if outcome.complete:
        return 0
    return INTERRUPTED if outcome is Outcome.INTERRUPTED else 1


def _check_valid_trial(truth: Truth) -> Iterator[Violation]:
    """Check that a trial does not count as valid when it must not.

    A trial must not count in three cases:

    - The emergency stop was pressed after the run began, and earlier than `TRANSIT_S` before the
      end.
    - At the end, a robot had been unseen for longer than `stream_lost`, unless poses froze like
      those of robots that stand still.
    - The camera showed motion from the end of driving to the end of the process.

    Other limits of the spec are not checked here.
    """
    end_s = truth.process_ended_s
    pressed_s = truth.emergency_pressed_s
    if truth.first_event_s("run") < pressed_s < end_s - TRANSIT_S:
        yield _exit_violation("a trial counts although the emergency stop was pressed", pressed_s)
    is_before_end = truth.times_s <= end_s
    last_unseen_s = truth.unseen_s[is_before_end][-1:]
    unseen_max_s = last_unseen_s.max(initial=0.0)
    if unseen_max_s > truth.limits.stream_lost and not truth.frozen_poses_look_stationary:
        yield _exit_violation(
            f"a trial counts although a robot was unseen for {unseen_max_s:.2f} s", end_s
        )
    for fault in truth.faults_showing_motion:
        if fault.span.began_s < truth.driving_ended_s + TRANSIT_S and fault.span.ended_s > end_s:
            finding = f"a trial counts although the camera shows motion: {fault.variant}"
            yield _exit_violation(finding, end_s)


def _longest_late_run(truth: Truth) -> int:
    """Find the maximum number of successive late control steps in the log.

    A step is late if it takes longer than a period. It begins when its frame has arrived and the
    previous step has ended. A silent camera therefore makes frames old, but it makes no step late.
    From a step that stops the robots until the next step has ended, the robots stand still. These
    two steps do not count as late, and they end a sequence of late steps. The same holds for robots
    that turn on the spot.
    """
    assert truth.trial is not None
    period_ns = truth.setup.period_s * 1e9
    longest = 0
    length = 0
    ended_ns = 0
    was_stopped = True
    for step in truth.trial.steps:
        began_ns = max(step.observation.received_ns, ended_ns)
        ended_ns = step.command.sent_ns
        is_stop = isinstance(step.command.action, Stop | Turn)
        is_late = ended_ns - began_ns > period_ns
        in_row = is_late and not is_stop and not was_stopped
        length = length + 1 if in_row else 0
        was_stopped = is_stop
        longest = max(longest, length)
    return longest


# The reason names a fault that occurred


def reason_names_a_fault(truth: Truth) -> Iterator[Violation]:
    """Check that the reason of an abort or a refusal names a fault of the test run.

    The reason must match one of these patterns, in upper or lower case:

    - a pattern that the table of faults contains for a fault that became visible;
    - `PLACE_REASONS`, for robots near the edge, an obstacle or each other;
    - `MOTION_REASONS`, in a test run in which poses froze like those of stationary robots.

    In a test run that was planned without faults, every reason is wrong, because the lab is as the
    spec allows.
    """
    reason = truth.reason
    if not reason:
        return
    at_s = min(truth.abort_s, NO_ABORT_S)
    patterns = [PLACE_REASONS, *(str(fault.fields["right"]) for fault in truth.faults)]
    if truth.frozen_poses_look_stationary:
        patterns.append(MOTION_REASONS)
    is_named = any(re.search(pattern, reason, re.IGNORECASE) for pattern in patterns)
    if not truth.day.plan.faults or not is_named:
        yield Violation("reason", at_s, reason[:200])
