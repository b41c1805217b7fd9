"""Checks the commands on /commands of a lab's log: those of the control steps and those between.

    between steps     the action of the last step again, or a stop
    wheels            they stand after a stop, and of a robot that is held still; else its speed and
                      turning rate are s (v, a sin(u - theta)) by (24)-(25), within the tolerances
                      below: the host rounds them, predicts the heading theta from a late frame,
                      and scales both by s < 1 if a wheel would be too fast
    times             an action is sent again at the actuator's rate, by `next_due_ns`

A stop is sent STOPS times. Actions before the first step are not compared. In real time a busy
computer sends late: of repetitions a smaller share than of control steps in 25 of 25 emulated
trials, on two cores with up to 13 processes.
"""

from collections.abc import Iterator
from itertools import islice, pairwise

import numpy as np

from tetractl.core.clock import MILLISECOND, SECOND, MonotonicClock, next_due_ns
from tetractl.core.commands import Command, Steer, Stop, Turn
from tetractl.core.plan import Outcome
from tetractl.core.poses import Bools, Floats
from tetractl.core.trial import HALTS, Result
from tetractl.experiment.lab_section import STOP_GAP_NS, STOPS, UNTRACKED_STOP_S, LabSection
from tetractl.log.read.trial_log import TrialLog
from tetractl.model.motion.rolling import wheel_speeds
from tetractl.model.wheels import body_velocity
from tetractl.replay.comparison import Difference

SPEED_SHARE = 0.3
"""Largest difference between a robot's commanded speed and its own, as a share of its own: up to
0.04 in 14 emulated trials of m3pi robots, whose wheels have counts of 8 mm/s, and 0.21 in 4 of
cubes."""
TURN_SHARE = 0.3
"""Largest difference between a commanded turning rate and those for the possible headings, as a
share of a, for the same reason."""
AHEAD_S = 0.1
"""Longest time over which the host predicts headings [s], besides the wheels' lag."""
FASTEST_SHARE = 0.9
"""A robot's speed may be reduced if a wheel has this share of the greatest speed in the log."""
LATE_NS = 15 * MILLISECOND
"""Longest time that a transmission may be late [ns]: it waits for a step of the inner loop, up to
10 ms; it was late by up to 7 ms in the same trials."""
DOUBLED_NS = MILLISECOND // 5
"""Time between two transmissions of which one was added [ns]: the least of 1,900 on a busy computer
was 1 ms."""
UNTIMELY_SHARE = 0.1
"""Largest share of transmissions that may be later in real time, unless more control steps are, and
of those that may be earlier, as in logs before 2026-12."""


def command_differences(log: TrialLog, result: Result) -> Iterator[Difference]:
    """Yield the first contradiction of each kind in the commands of an undamaged log of a lab."""
    lab = log.experiment.plant
    if not isinstance(lab, LabSection):
        return
    actuator = lab.actuator.build(log.start.setup, MonotonicClock())
    halts = "yes" if actuator.halts else "no"
    if log.start.plant.facts.get(HALTS, halts) != halts:
        yield Difference(None, f"run.facts.{HALTS}", f"must be {halts!r} for this actuator")
    sent = sorted(log.commands, key=lambda command: command.sent_ns)
    kinds = (
        _actions(log, sent, result),
        () if actuator.halts else _deliveries(sent),
        _wheels(log, sent),
        _times(log, sent, actuator.period_ns, lab.real_time),
        _stops(log, sent, result),
    )
    for kind in kinds:
        yield from islice(kind, 1)


def _deliveries(sent: list[Command]) -> Iterator[Difference]:
    """Yield each command that some robots in one field are said to have received, and some not."""
    for command in sent:
        if len(set(command.delivered)) > 1:
            text = f"{command.delivered} of one field, sent at {command.sent_ns} ns"
            yield Difference(None, "commands.delivered", text)


def _actions(log: TrialLog, sent: list[Command], result: Result) -> Iterator[Difference]:
    """Yield each command after the first step that is neither the last step's nor a stop. In a
    trial that was aborted, the last direction may be of a step that was not ended."""
    steps = {step.command.sent_ns: step for step in log.steps}
    last_ns = max((command.sent_ns for command in sent if not command.stops), default=0)
    last = None
    for command in sent:
        last = steps.get(command.sent_ns, last)
        if last is None or isinstance(command.action, Stop):
            continue
        is_unfinished = command.sent_ns == last_ns and result.outcome is Outcome.ABORTED
        if command.action != last.command.action and not is_unfinished:
            text = f"{command.action} is sent after it, at {command.sent_ns} ns"
            yield Difference(last.k, "command", text)


def _wheels(log: TrialLog, sent: list[Command]) -> Iterator[Difference]:
    """Yield each command whose wheel speeds are not those of its action."""
    setup = log.start.setup
    if not setup.on_wheels:
        return
    commands = [command for command in sent if command.left is not None]
    wheels = np.array([[command.left, command.right] for command in commands], dtype=np.float64)
    wheels = wheels.reshape(-1, 2, len(setup.names))  # the left and the right one of each robot
    fastest = np.abs(wheels).max(axis=(0, 1), initial=0.0)
    for command, speeds in zip(commands, wheels, strict=True):
        is_wrong = (speeds != 0).any(axis=0)  # of robots that stand
        if isinstance(command.action, Steer | Turn):
            is_off = _do_not_follow(log, command.sent_ns, command.action, speeds, fastest)
            is_wrong = np.where(command.delivered, is_off, is_wrong)
        if is_wrong.any():
            name = setup.names[int(np.argmax(is_wrong))]
            text = f"wheels of {name} do not follow what is sent at {command.sent_ns} ns"
            yield Difference(None, "commands", text)


def _do_not_follow(
    log: TrialLog, sent_ns: int, action: Steer | Turn, wheels: Floats, fastest: Floats
) -> Bools:
    """Return of which robots (N,) the wheels (2, N) do not do what an action asks; `fastest` (N,)
    are the greatest speeds of their wheels in the log. The guard may have refused a robot's poses
    for up to UNTRACKED_STOP_S, so that an earlier heading was used.
    """
    setup = log.start.setup
    radius = setup.wheel_radius
    assert radius is not None, "the robots have wheels"
    speed, turning = body_velocity(wheels[0], wheels[1], radius)
    if isinstance(action, Steer):
        towards = action.direction
        asked_speed = setup.speed
        is_scaled = np.abs(wheels).max(axis=0) >= FASTEST_SHARE * fastest
        scale = np.where(is_scaled, np.clip(speed / setup.speed, 0, 1), 1)
    else:
        towards = action.facing
        asked_speed = np.zeros_like(setup.speed)
        scale = np.ones_like(setup.speed)
    is_off = np.asarray(np.abs(speed - asked_speed * scale) > SPEED_SHARE * setup.speed)
    since_ns = sent_ns - round(UNTRACKED_STOP_S * SECOND)
    is_used = (log.received_ns >= since_ns) & (log.received_ns <= sent_ns)
    if is_used.any():
        ahead = np.linspace(-1, 1, 9)[:, None] * setup.a * (AHEAD_S + setup.lag_s)
        headings = (log.mocap[is_used][:, None, :, 2] + ahead).reshape(-1, len(setup.names))
        left, right = wheel_speeds(np.sin(towards - headings), setup.a, asked_speed, radius)
        _, rates = body_velocity(left, right, radius)
        rates *= scale
        is_off |= turning < rates.min(axis=0) - TURN_SHARE * setup.a
        is_off |= turning > rates.max(axis=0) + TURN_SHARE * setup.a
    return is_off


def _times(
    log: TrialLog, sent: list[Command], period_ns: int, real_time: bool
) -> Iterator[Difference]:
    """Yield that an action was sent again too early, or too seldom."""
    decided = {step.command.sent_ns for step in log.steps}
    early_ns: list[int] = []
    late_ns: list[int] = []
    count = 0
    before: Command | None = None
    due_ns = 0
    for command in sent:
        now_ns = command.sent_ns
        if before is not None and not before.stops:
            count += 1
            is_again = now_ns not in decided and command.action == before.action
            if is_again and command.delivered == before.delivered:
                if now_ns - before.sent_ns < period_ns // 2:
                    early_ns.append(now_ns - before.sent_ns)
                due_ns = min(due_ns, now_ns)  # it was due, and may have been so before
            if now_ns > due_ns + LATE_NS:
                late_ns.append(now_ns)
        elif not command.stops:
            due_ns = now_ns + period_ns  # at the latest
        due_ns = next_due_ns(due_ns, now_ns, period_ns)
        before = command
    share = max(UNTIMELY_SHARE, _late_steps(log)) if real_time else 0
    most = share * count
    doubled_ns = [gap_ns for gap_ns in early_ns if gap_ns < DOUBLED_NS]
    if doubled_ns or len(early_ns) > most:
        text = f"sent again after {early_ns[0] / MILLISECOND:g} ms"
        yield Difference(None, "commands", text)
    if len(late_ns) > most:
        text = f"{len(late_ns)} of {count} come later than the actuator's rate, the first at"
        yield Difference(None, "commands", f"{text} {late_ns[0]} ns")


def _late_steps(log: TrialLog) -> float:
    """Return the share of control steps that were sent late."""
    due_ns = round(log.experiment.controller.period * SECOND) + LATE_NS
    gaps_ns = [
        after.command.sent_ns - step.command.sent_ns
        for step, after in pairwise(log.steps)
        if not step.plan.pauses
    ]
    return sum(gap_ns > due_ns for gap_ns in gaps_ns) / max(len(gaps_ns), 1)


def _stops(log: TrialLog, sent: list[Command], result: Result) -> Iterator[Difference]:
    """Yield that fewer stops were sent in a row than there must be; robots in one field are held
    still by single stops, and after an abort an actuator may have failed."""
    if not log.start.setup.on_wheels or not result.outcome.complete:
        return
    series: list[int] = []
    since_ns: int | None = None  # the last stop, None after another action
    for command in sent:
        if not isinstance(command.action, Stop):
            since_ns = None
            continue
        if since_ns is None or command.sent_ns - since_ns > STOPS * STOP_GAP_NS:
            series.append(0)
        series[-1] += 1
        since_ns = command.sent_ns
    for count in series:
        if count < STOPS:
            yield Difference(None, "commands", f"{count} stops in a row, not {STOPS}")
