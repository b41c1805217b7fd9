"""The seven invariants that every randomised test run (a *day*) of an emulated lab must fulfil.

An emulated lab records what truly happened. An observer, which shares no code with the guard,
compares this record with the invariants. Each invariant is a function, and its docstring lists
everything that it checks:

| invariant                        | function               | main bound                      |
| -------------------------------- | ---------------------- | ------------------------------- |
| no robot is driven blind         | `driven_blind`         | limits of the spec, `reaction`  |
| robots rest after a stop         | `rests_after_a_stop`   | `TRANSIT_S`, watchdog, `ROLL_S` |
| robots stay inside and apart     | `stays_inside`         | pose errors, pushes, coasting   |
| poses and the result are true    | `poses_are_true`       | `POSE_MM` etc.; `RESULT_MM`     |
| the log is readable and complete | `log_is_readable`      | see `outcome_invariants`        |
| the exit code is right           | `exit_code_is_right`   | see `outcome_invariants`        |
| the reason names a true fault    | `reason_names_a_fault` | see `outcome_invariants`        |

The checks are coarse on purpose. Unless a docstring says otherwise, a fault widens or removes a
bound for all robots and for the whole day, even before the fault begins. The checks may therefore
miss a violation, but they never report a false one.

Distances are in mm, times in s. As in `truth`, T counts exposures and N robots.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations

import numpy as np

from tetractl.core.poses import Bools, Floats
from tetractl_emulator.fault_rows import FRAME_S
from tetractl_emulator.m3pi.wheeled_side import LAG_MAX_S
from tetractl_emulator.rehearsal.logged import MUTE, SHOWN_S
from tetractl_emulator.rehearsal.outcome_invariants import (
    exit_code_is_right,
    log_is_readable,
    reason_names_a_fault,
)
from tetractl_emulator.rehearsal.truth import (
    EMERGENCY_FLAG,
    LATCHED_BIT,
    RUNNING_BIT,
    SILENT_BIT,
    TRANSIT_S,
    VISIBLE_SPEED_MM_S,
    RecordedEvent,
    Truth,
    Violation,
    VisibleFault,
    time_s,
)

Invariant = Callable[[Truth], Iterator[Violation]]

DRIVING_WINDOW_S = 4.0
"""Time of driving of which each robot must be shown for at least half [s].

In this time, it crosses half the arena.
"""
ROLL_S = LAG_MAX_S * math.log(1000.0)
"""Time in which the slowest wheels slow down from 1 m/s to 1 mm/s [s]."""
ROLLS_MM_S = 1.5
"""Wheel speed above which a robot counts as moving after `ROLL_S`: slightly above 1 mm/s [mm/s]."""
DRIVEN_MM_S = 5.0
"""Wheel speed above which a robot counts as driven [mm/s]."""
STOPS_MIN = 5
"""Minimum number of stops after a run.

A radio that loses every second packet takes one of them on 97 of 100 days.
"""
WATCHED_S = 2.0
"""Time after the end in which stops are repeated while a robot is not seen to stand still [s]."""
NOISE_MM = 4.0
"""Noise of a position of the worst camera [mm]."""
TILT_NOISE_RAD = 0.05
"""Noise of a tilt of the worst camera [rad]."""
MOTION_SEEN_S = NOISE_MM / VISIBLE_SPEED_MM_S
"""Time after which the slowest motion that counts exceeds the noise [s]."""
POSE_MM = 47.5
"""Maximum error of an accepted position [mm].

It is half a body's length, beyond which the position is not on its robot.
"""
POSE_RAD = 1.0
"""Maximum error of an accepted heading [rad].

It is the turn by which a robot leaves its path.
"""
RESULT_MM = 10.0
"""Maximum error of a result [mm].

It is 0.03 s of driving at 200 mm/s, and the noise of poses at standstill.
"""
REFUSED_S = 0.05
"""Time of refused poses after which a robot has to stop [s]."""
FORGET_S = 1.0
"""Time for which robots remember the number of the last new command [s]."""
LEFT_SEEN_S = 0.75
"""Time for which a robot must be shown driving, so that the motion can be seen [s]."""
READING_WAITS_S = 0.03
"""Maximum time for which a reading of a mat waits for an event of its connection [s]."""
BODY_MM = 60.0
"""Height of a body on an emulated robot above the floor [mm]."""
LIFTED_MM = 40.0
"""Maximum height by which a robot may be lifted once it drives [mm]."""
RESTARTING_FAULTS = ("off", "reboots")
"""Names of the faults after which a robot has forgotten all commands."""
DRIVEN_BY_OTHERS = ("driven_elsewhere",)
"""Names of the faults by which another program drives the robots."""
LIFTING_FAULTS = ("lifted", "tipped")
"""Names of the faults that lift a body off the floor.

A camera may track it, but shows no robot.
"""
STOP_LOSING_FAULTS = (
    *("loss", "deaf", "unplug", "stuck_port", "radio_resets", "baud", "bad_bytes"),
    *("signal", "stopped", "off", "busy", "reboots"),
)
"""Names of the faults by which a stop may not reach a robot.

The robot's watchdog then has to stop it.
"""


def violations(truth: Truth) -> list[Violation]:
    """List the violations of all invariants in a test run with robots. Empty if it has none."""
    return [violation for invariant in INVARIANTS for violation in invariant(truth)]


# 1: no robot is driven blind


def driven_blind(truth: Truth) -> Iterator[Violation]:
    """Check that no robot is driven blindly.

    A robot is driven blindly if the camera has not shown it for too long, if the camera shows it
    too seldom, or if the controller gives no direction. Only the first finding is reported. Test
    runs in which poses froze like those of stationary robots are not checked.
    """
    if truth.frozen_poses_look_stationary:
        return
    violation = _first_blind_command(truth)
    if violation is None:
        violation = _first_seldom_shown(truth)
    if violation is not None:
        yield violation


def _first_blind_command(truth: Truth) -> Violation | None:
    """Find the first command that drives a robot blindly.

    A command does so in three cases:

    1. When the command stops acting, a robot that it drives has not been shown for `stale` +
      `reaction`.
    2. When the command stops acting, any robot, even a stationary one, has not been shown for
       `untracked_abort` + `reaction`.
    3. When the command is sent, the controller has given no direction for too long: `reaction` plus
       the longer of `stream_lost` and `late_steps` + 1 control periods.

    If frames are late but their times do not show it, `hidden_delay_s` is added in the first two
    cases. If nothing could be sent in a test run, or if our process was killed, the next command
    may be missing for this reason. The first two cases are then checked when a command is sent, and
    the third is not checked.
    """
    limits = truth.limits
    driven_max_s = limits.stale + limits.reaction + truth.hidden_delay_s
    any_max_s = limits.untracked_abort + limits.reaction + truth.hidden_delay_s
    late_steps_s = (limits.late_steps + 1) * truth.setup.period_s
    undirected_max_s = max(limits.stream_lost, late_steps_s) + limits.reaction
    is_mute = truth.had_fault(*MUTE) or truth.was_killed
    off_floor = [fault for fault in hiding_faults(truth) if fault.name in LIFTING_FAULTS]
    for i, command in enumerate(truth.commands):
        driven = np.array(truth.driven_by(command), bool)
        if not driven.any():
            continue
        unseen_s = _unseen_s(truth, command, 0.0 if is_mute else truth.acting_s[i], off_floor)
        undirected_s = truth.undirected_s[i]
        if unseen_s[driven].max() > driven_max_s or unseen_s.max() > any_max_s:
            finding = f"robots were driven although one had been unseen for {unseen_s.max():.3f} s"
        elif undirected_s > undirected_max_s and not is_mute:
            finding = f"robots were driven without a new direction for {undirected_s:.2f} s"
        else:
            continue
        return Violation("driven blind", time_s(command), finding)
    return None


def _unseen_s(
    truth: Truth, command: RecordedEvent, acts_s: float, off_floor: Sequence[VisibleFault]
) -> Floats:
    """Compute how long each robot was unseen when a command had acted for `acts_s` [s], shape (N,).

    A robot that a fault in `off_floor` lifts when the command is sent counts as unseen since the
    begin of the fault, even if the camera tracks it.
    """
    unseen_s = np.array(command["unseen_ms"]) / 1000 + acts_s
    at_s = time_s(command)
    for fault in off_floor:
        if fault.span.began_s < at_s < fault.span.ended_s:
            robot = truth.robot_index_of(fault)
            unseen_s[robot] = max(unseen_s[robot], at_s + acts_s - fault.span.began_s)
    return unseen_s


def _first_seldom_shown(truth: Truth) -> Violation | None:
    """Find the first time at which a robot was unseen for more than half of `DRIVING_WINDOW_S`.

    The window is the last `DRIVING_WINDOW_S` during which the guard let robots be driven. It leaves
    out pauses. A robot counts as unseen if it has not been shown for `stale` plus the longest delay
    of frames. `_first_blind_command` checks how old a pose may be.
    """
    row_s = np.diff(truth.times_s, append=truth.process_ended_s).clip(0.0, FRAME_S * 2)
    driving_s = np.where(_may_be_driven(truth), row_s, 0.0)
    driven_s = np.cumsum(driving_s)
    is_unseen = truth.unseen_s > truth.limits.stale + truth.longest_delay_s
    blind_s = np.cumsum(np.where(is_unseen, driving_s[:, None], 0.0), axis=0)
    window_begins = np.searchsorted(driven_s, driven_s - DRIVING_WINDOW_S)
    most_blind_s = (blind_s - blind_s[window_begins]).max(axis=1, initial=0.0)
    is_seldom = most_blind_s > DRIVING_WINDOW_S / 2
    if not is_seldom.any():
        return None
    at_s = float(truth.times_s[is_seldom.argmax()])
    finding = f"a driven robot was unseen for half of {DRIVING_WINDOW_S:g} s"
    return Violation("driven blind", at_s, finding)


def _may_be_driven(truth: Truth) -> Bools:
    """Find the exposures at which the guard lets robots be driven, shape (T,).

    An interval includes its start, but not its end.
    """
    may_drive = np.zeros(len(truth.times_s), bool)
    for span in truth.driven_spans:
        may_drive |= (truth.times_s >= span.began_s) & (truth.times_s < span.ended_s)
    return may_drive


# 2: robots rest after a stop


def rests_after_a_stop(truth: Truth) -> Iterator[Violation]:
    """Check that robots stay stopped after a stop.

    - After the end, no wheel turns, and no command drives a robot.
    - An emergency stop is never released.
    - Stationary robots are not driven again.
    - Enough stops are sent as long as the camera has not shown that a robot stands still.
    - A run also begins at standstill.

    Stops are not counted if nothing could be sent in the test run, or if our process was killed.
    """
    yield from _wheels_stand(truth)
    yield from _none_is_left_driving(truth)
    yield from _no_command_drives(truth)
    yield from _emergency_stop_is_sent(truth)
    yield from _latched_robots_stay(truth)
    yield from _none_runs_again(truth)
    if not truth.had_fault(*MUTE) and not truth.was_killed:
        yield from _stops_are_sent(truth)
        yield from _stops_are_repeated(truth)
    yield from _run_begins_at_rest(truth)


def _not_at_rest(at_s: float, finding: str) -> Violation:
    """Create a violation of the invariant that robots rest after a stop, at a time [s]."""
    return Violation("not at rest", at_s, finding)


def _radio_late_s(truth: Truth) -> float:
    """Compute the total delay of commands that faults of the radio cause [s]. 0 without any."""
    return truth.total_delay_s("late_radio", "overtaken_packets", "reboots")


def _wheels_stand(truth: Truth) -> Iterator[Violation]:
    """Check that no wheel turns after the end, or after a kill if it came first.

    Before the check, a last command may still arrive, a watchdog may expire, and wheels may coast.
    Test runs in which another program drove the robots are not checked, because it may start at any
    time.
    """
    if truth.had_fault(*DRIVEN_BY_OTHERS):
        return
    bound_s = TRANSIT_S + truth.watchdog_s + ROLL_S + _radio_late_s(truth)
    must_rest = truth.times_s > truth.undriven_from_s + bound_s
    is_rolling = must_rest[:, None] & (truth.wheel_speed_mm_s > ROLLS_MM_S)
    if is_rolling.any():
        row, i = np.argwhere(is_rolling)[0]
        yield _not_at_rest(float(truth.times_s[row]), f"{truth.setup.names[i]} moves")


def _none_is_left_driving(truth: Truth) -> Iterator[Violation]:
    """Check that no robot is left driving after our process has ended, or that the run names it.

    A robot is left driving if its wheels turn `CONTINUE_NS` later, when all commands have ended.
    The wheels must also have turned in the last `LEFT_SEEN_S` of our process, so that this could
    be seen. It is allowed if the camera did not show the robot at this time, if the robot did not
    receive commands, or if a signal hurried the end. Even then, the run must name the robot.

    Not checked: test runs with a kill; runs in which nothing could be sent; runs with false or
    repeated poses, which made robots seem to stand still; and robots that no camera showed before a
    run began.
    """
    hidden = truth.creeping_faults or truth.had_fault("repeat", "freeze", "swap", *MUTE)
    if truth.was_killed or hidden or not len(truth.times_s):
        return
    is_turning = truth.wheel_speed_mm_s > ROLLS_MM_S
    is_last_moment = (truth.times_s > truth.process_ended_s - LEFT_SEEN_S) & (
        truth.times_s < truth.process_ended_s
    )
    is_shown: Bools = np.all(truth.unseen_s[is_last_moment] < SHOWN_S, axis=0)
    drives_on: Bools = is_turning[-1] & np.all(is_turning[is_last_moment], axis=0)
    could_be_held = not truth.had_fault(*STOP_LOSING_FAULTS, "late_radio", "overtaken_packets")
    for i in np.flatnonzero(drives_on & (is_shown | (truth.steering_began_s < np.inf))).tolist():
        name = truth.setup.names[i]
        if name not in truth.robots_named_at_end:
            yield _not_at_rest(
                truth.process_ended_s, f"{name} is left driving, and the report does not name it"
            )
        elif is_shown[i] and could_be_held:
            yield _not_at_rest(truth.process_ended_s, f"{name} is left driving")


def _no_command_drives(truth: Truth) -> Iterator[Violation]:
    """Check that no command drives robots after the end, unless it is replaced within TRANSIT_S.

    Only the first violation is yielded.
    """
    for command, acts_s in zip(truth.commands, truth.acting_s.tolist(), strict=True):
        if (
            time_s(command) > truth.driving_ended_s
            and acts_s > TRANSIT_S
            and any(truth.driven_by(command))
        ):
            yield _not_at_rest(time_s(command), "a command drives")
            return


def _emergency_stop_is_sent(truth: Truth) -> Iterator[Violation]:
    """Check that an emergency stop is sent soon after the operator presses it.

    The check applies if the operator's first press comes after a run has begun. A command with the
    flag of an emergency stop must then be sent within `TRANSIT_S`, before or after. All commands
    later than this must also have the flag. The check is skipped if nothing could be sent, or if
    our process ended within `TRANSIT_S`.
    """
    pressed_s = truth.emergency_pressed_s
    is_in_run = truth.first_event_s("run") < pressed_s < truth.process_ended_s - TRANSIT_S
    if not is_in_run or truth.had_fault(*MUTE):
        return
    stopping_s = [
        time_s(command) for command in truth.commands if command["flags"] & EMERGENCY_FLAG
    ]
    others_s = [
        time_s(command) for command in truth.commands if not command["flags"] & EMERGENCY_FLAG
    ]
    if not any(pressed_s - TRANSIT_S < at_s < pressed_s + TRANSIT_S for at_s in stopping_s):
        yield _not_at_rest(pressed_s, "no emergency stop is sent")
    if any(at_s > pressed_s + TRANSIT_S for at_s in others_s):
        yield _not_at_rest(pressed_s, "a command releases the emergency stop")


def _latched_robots_stay(truth: Truth) -> Iterator[Violation]:
    """Check that a robot that has latched an emergency stop stays latched.

    Test runs in which a robot restarted are not checked, because a restart releases the stop.
    """
    is_latched = truth.has_status(LATCHED_BIT)
    is_released = (is_latched[:-1] & ~is_latched[1:]).any(axis=1)
    if is_released.any() and not truth.had_fault(*RESTARTING_FAULTS):
        released_row = 1 + is_released.argmax()
        yield _not_at_rest(
            float(truth.times_s[released_row]), "the emergency stop of a robot is released"
        )


def _none_runs_again(truth: Truth) -> Iterator[Violation]:
    """Check that a stationary robot that has received the final stop does not run again.

    Only a command that a later command has overtaken could drive it. Such a command is not checked.
    Robots whose commands have no number cannot know that a command was overtaken, so it may drive
    them as long as it is on its way. Robots with numbered commands forget a number after
    `FORGET_S`, and an old command may drive them after that.

    A robot that stands still counts as having received the final stop, unless its watchdog stopped
    it. A radio that delays all commands equally also delays the final stop. Test runs in which
    another program drove the robots are not checked.
    """
    stopped_s = truth.driving_ended_s + TRANSIT_S + truth.total_delay_s("late_radio", "reboots")
    overtaken_s = truth.total_delay_s("overtaken_packets")
    has_numbers = any("sequence" in command for command in truth.commands)
    if not has_numbers or overtaken_s > FORGET_S:
        stopped_s += overtaken_s
    is_after = (truth.times_s > stopped_s)[:, None]
    is_running = truth.has_status(RUNNING_BIT)
    is_stationary = is_after & ~is_running & ~truth.has_status(SILENT_BIT)
    has_stood = np.maximum.accumulate(is_stationary, axis=0)
    runs_again = (has_stood & is_running).any(axis=1)
    if runs_again.any() and not truth.had_fault(*DRIVEN_BY_OTHERS):
        yield _not_at_rest(
            float(truth.times_s[runs_again.argmax()]), "a robot is driven again after its stop"
        )


def _stops_are_sent(truth: Truth) -> Iterator[Violation]:
    """Check that enough stops are sent after each time of driving.

    From `TRANSIT_S` before the end of driving until one watchdog time after it, at least
    `STOPS_MIN` commands that drive no robot must be sent. Only the first violation is reported.
    Nothing is checked if our process ended within this time.
    """
    for span in truth.driven_spans:
        until_s = span.ended_s + truth.watchdog_s
        stop_times_s = [
            at_s for at_s in truth.stop_commands_s if span.ended_s - TRANSIT_S < at_s < until_s
        ]
        if len(stop_times_s) < STOPS_MIN and until_s < truth.process_ended_s:
            yield _not_at_rest(span.ended_s, f"only {len(stop_times_s)} stops were sent")
            return


def _stops_are_repeated(truth: Truth) -> Iterator[Violation]:
    """Check that stops continue after the end until the camera shows that all robots stand still.

    The check covers the first `WATCHED_S` after the end. If a robot has not been seen standing
    still for `ROLL_S` plus `MOTION_SEEN_S`, the last stop must never be older than `MOTION_SEEN_S`
    plus `TRANSIT_S`. In three cases, a robot is not seen standing still: while it moves and is
    shown; while a fault makes it seem to move; and while it has not been shown for one watchdog
    time longer than another robot.
    """
    stops_s = np.array([-np.inf, *truth.stop_commands_s])
    times_s = truth.times_s
    unseen_s = truth.unseen_s
    is_restless = ((truth.wheel_speed_mm_s > DRIVEN_MM_S) & (unseen_s < SHOWN_S)).any(axis=1)
    is_restless |= np.ptp(unseen_s, axis=1) > truth.watchdog_s
    for fault in truth.faults_showing_motion:
        is_restless |= (times_s > fault.span.began_s) & (times_s < fault.span.ended_s)
    is_restless &= times_s > truth.driving_ended_s
    at_rest_s = np.maximum.accumulate(np.where(is_restless, truth.driving_ended_s, times_s))
    must_stop = is_restless & (times_s - at_rest_s > ROLL_S + MOTION_SEEN_S)
    must_stop &= times_s < min(truth.driving_ended_s + WATCHED_S, truth.process_ended_s)
    stop_age_s = times_s - stops_s[np.searchsorted(stops_s, times_s) - 1]
    is_too_old = must_stop & (stop_age_s > MOTION_SEEN_S + TRANSIT_S)
    if is_too_old.any():
        row = int(is_too_old.argmax())
        finding = (
            f"no stop was sent for {stop_age_s[row]:.2f} s although the cameras had not "
            "shown that a robot stands still"
        )
        yield _not_at_rest(float(times_s[row]), finding)


def _run_begins_at_rest(truth: Truth) -> Iterator[Violation]:
    """Check that the first run does not begin while a fault shows motion.

    The fault must have shown the motion for long enough to be seen.
    """
    begins_s = truth.first_event_s("run")
    shown_s = MOTION_SEEN_S + truth.limits.latency + TRANSIT_S
    for fault in truth.faults_showing_motion:
        if fault.span.began_s + shown_s < begins_s < fault.span.ended_s:
            yield _not_at_rest(
                begins_s, f"a run starts although the camera shows motion: {fault.variant}"
            )


# 3: robots stay inside the arena and apart


def stays_inside(truth: Truth) -> Iterator[Violation]:
    """Check that no robot leaves the arena, enters an obstacle or comes too close to another robot.

    Each robot may exceed the limits by the sum of four values: the maximum error of its pose so
    far, the distance that its fastest wheel so far covers within `_rolls_on_s`, half the noise, and
    all pushes of the test run. The minimum distance between robots is `separation_mm`. The worst
    place of a single robot and the worst place of a pair are reported. Test runs in which another
    program drove the robots, or in which false poses look like true ones, are not checked.
    """
    if not len(truth.times_s) or truth.had_fault(*DRIVEN_BY_OTHERS) or truth.false_poses_look_true:
        return
    speed_mm_s = np.maximum.accumulate(truth.wheel_speed_mm_s, axis=0)
    error_mm = np.maximum.accumulate(truth.position_error_mm, axis=0)
    allowed_mm = error_mm + speed_mm_s * _rolls_on_s(truth) + NOISE_MM / 2
    pushed_mm = _pushed_mm(truth)
    names = truth.setup.names
    yield from _worst_place(truth, truth.outside_mm - allowed_mm - pushed_mm, names)
    robot_pairs = list(combinations(range(len(names)), 2))
    if not robot_pairs:
        return
    positions = truth.poses[..., 0] + 1j * truth.poses[..., 1]
    too_near = list[Floats]()
    for i, j in robot_pairs:
        apart_mm = np.abs(positions[:, i] - positions[:, j])
        lacking_mm = truth.limits.separation_mm - apart_mm
        too_near.append(lacking_mm - allowed_mm[:, i] - allowed_mm[:, j])
    pair_names = [f"{names[i]}, {names[j]}" for i, j in robot_pairs]
    yield from _worst_place(truth, np.stack(too_near, axis=1) - pushed_mm, pair_names)


def _pushed_mm(truth: Truth) -> float:
    """Sum the distances by which people pushed robots in the test run [mm].

    The pushes must be added, because no frame shows a push immediately.
    """
    return sum(math.hypot(*fault.fields["by"]) for fault in truth.faults_of("pushed"))


def _rolls_on_s(truth: Truth) -> Floats:
    """Compute how long robots may roll on, in addition to the guard's `reaction` [s], shape (T, N).

    It is the sum of several times: the longest time so far for which a robot was driven unseen, the
    delay of frames, the delay of a stop on its way to the robot, and the robot's lag. If a stop may
    fail, the robot's watchdog is added.
    """
    stops_s = TRANSIT_S + LAG_MAX_S + _radio_late_s(truth)
    if truth.had_fault(*STOP_LOSING_FAULTS):
        stops_s += truth.watchdog_s
    driven_unseen_s = np.where(truth.wheel_speed_mm_s > DRIVEN_MM_S, truth.unseen_s, 0.0)
    unseen_s = np.maximum.accumulate(driven_unseen_s, axis=0) + truth.hidden_delay_s
    return np.maximum(0.0, unseen_s + stops_s - truth.limits.reaction)


def _worst_place(truth: Truth, beyond_mm: Floats, names: Sequence[str]) -> Iterator[Violation]:
    """Yield the worst violation of a limit, among these robots or pairs of robots.

    Args:
        truth: What truly happened.
        beyond_mm: How far each robot or pair is beyond the limit at each exposure, shape (T, number
            of names) [mm]. Nothing is yielded if no value is above 0.
        names: Names of the robots or pairs.
    """
    if (beyond_mm > 0).any():
        row, i = np.unravel_index(int(beyond_mm.argmax()), beyond_mm.shape)
        finding = f"{names[int(i)]}: {beyond_mm[row, i]:.0f} mm beyond what is allowed"
        at_s = float(truth.times_s[row])
        yield Violation("outside", at_s, finding)


# 4: poses and the result are true


def poses_are_true(truth: Truth) -> Iterator[Violation]:
    """Check that the poses in the log and in the result are true.

    - The accepted poses of driven robots are true.
    - False poses that were refused stay refused.
    - The log has no pose of a hidden robot.
    - The errors in the result of a complete trial are true.

    The first and the last point are not checked in a test run in which false poses look like true
    ones.
    """
    yield from _false_poses_stay_refused(truth)
    yield from _hidden_robots_have_no_pose(truth)
    if not truth.false_poses_look_true:
        yield from _accepted_poses_are_true(truth)
        yield from _result_is_true(truth)


def _accepted_poses_are_true(truth: Truth) -> Iterator[Violation]:
    """Check that no logged pose of a driven robot before the end is wrong.

    The allowed error of a position is `POSE_MM` plus all pushes of the test run. The allowed error
    of a heading is `POSE_RAD` plus all turns by people. The first wrong pose is reported,
    preferably one with a wrong position. A pose in a frame is only compared with the true poses at
    the times at which it may have been exposed, because the robot moves until the next frame.
    """
    is_driven = truth.wheel_speed_mm_s > DRIVEN_MM_S
    is_before_end = (truth.times_s < truth.driving_ended_s)[:, None]
    checked = truth.is_fresh & is_driven & is_before_end
    off_mm, off_rad = _least_pose_errors(truth)
    turned_rad = sum(abs(fault.fields.get("turn", 0.0)) for fault in truth.faults_of("pushed"))
    for errors, error_max, unit in (
        (off_mm - _pushed_mm(truth), POSE_MM, "mm"),
        (off_rad - turned_rad, POSE_RAD, "rad"),
    ):
        is_wrong = checked & (errors > error_max)
        if is_wrong.any():
            row, i = np.argwhere(is_wrong)[0]
            finding = (
                f"the accepted pose of {truth.setup.names[i]} is wrong by "
                f"{errors[row, i]:.3g} {unit}"
            )
            at_s = float(truth.times_s[row])
            yield Violation("untrue", at_s, finding)
            return


def _least_pose_errors(truth: Truth) -> tuple[Floats, Floats]:
    """Compute the distance of each accepted pose from the nearest true pose of its robot.

    Only true poses from the time in which the pose may have been exposed are compared. This time
    ends at the row's exposure, and lasts `hidden_delay_s`. It is longer if the pose repeats the
    previous pose to the last bit, because a frozen pose looks like the pose of a stationary robot.
    `stale`, `TRANSIT_S` and the watchdog are then added, because no command acts longer than this.

    Returns:
        The distance to the nearest position [mm] (T, N), and to the nearest heading [rad] (T, N).
        The two may come from different exposures. Infinite if no pose was accepted.
    """
    frozen_s = truth.limits.stale + TRANSIT_S + truth.watchdog_s
    may_be_old_s = truth.hidden_delay_s + np.where(truth.is_repeated, frozen_s, 0.0)
    rows = np.arange(len(truth.times_s))[:, None]
    earliest_rows = np.searchsorted(truth.times_s, truth.times_s[:, None] - may_be_old_s)
    robots = np.arange(truth.is_fresh.shape[1])
    least_mm = np.full(truth.is_fresh.shape, np.inf)
    least_rad = least_mm.copy()
    most_rows_back = int((rows - earliest_rows).max(initial=0))
    for rows_back in range(most_rows_back + 1):
        exposed_rows = np.maximum(rows - rows_back, earliest_rows)
        differences = truth.accepted_poses - truth.poses[exposed_rows, robots]
        off_mm = np.hypot(differences[..., 0], differences[..., 1])
        off_rad = np.abs(np.remainder(differences[..., 2] + np.pi, 2 * np.pi) - np.pi)
        least_mm = np.fmin(least_mm, off_mm)  # leaves out NaN, where there is no pose
        least_rad = np.fmin(least_rad, off_rad)
    return least_mm, least_rad


def _false_poses_stay_refused(truth: Truth) -> Iterator[Violation]:
    """Check that false and frozen poses stay refused.

    Once the guard has refused the poses of `REFUSED_S`, it must not accept a pose of this robot
    while the fault lasts, even after an abort. The exception is that the guard was `ready` in
    between. For each fault, the first accepted pose is reported. The check is skipped if another
    fault may have been the cause, and for readings of a mat, which also repeat while a robot stands
    still.
    """
    if truth.setup.sight.has_grid or truth.trial is None:
        return
    rows = np.unique(truth.logged_exposures).tolist()
    ready_s = [time_s(event) for event in truth.events("guard", state="ready")]
    for fault in truth.faults_of("ghost", "repeat"):
        other_spans = [other_fault.span for other_fault in truth.faults if other_fault is not fault]
        robots = [fault.fields["robot"]] if "robot" in fault.fields else truth.setup.names
        for i in map(truth.setup.names.index, robots):
            accepted_s = refused_s = np.inf
            for row in rows:
                at_s = float(truth.times_s[row])
                if not truth.is_fresh[row, i]:
                    refused_s = at_s
                    continue
                was_refused = refused_s - accepted_s > REFUSED_S
                is_acting = fault.span.began_s < refused_s and at_s < fault.span.ended_s
                is_only_fault = not any(
                    span.began_s < at_s and span.ended_s > accepted_s for span in other_spans
                )
                was_paused = any(accepted_s < ready < at_s for ready in ready_s)
                if was_refused and is_acting and is_only_fault and not was_paused:
                    finding = (
                        f"a false pose of {truth.setup.names[i]} is accepted again: {fault.variant}"
                    )
                    yield Violation("untrue", at_s, finding)
                    return
                accepted_s = at_s
                refused_s = -np.inf


def _hidden_robots_have_no_pose(truth: Truth) -> Iterator[Violation]:
    """Check that the log has no pose of a hidden robot.

    Two frames at the beginning and the end of the fault are exempt. The first pose of one robot is
    reported. Readings of a mat have the times of their arrival. Therefore, a reading until
    `READING_WAITS_S` after the beginning may come from before the fault.
    """
    arrives_s = READING_WAITS_S if truth.setup.sight.has_grid else 2 * FRAME_S
    for fault in hiding_faults(truth):
        began_s = fault.span.began_s + arrives_s
        ended_s = fault.span.ended_s - 2 * FRAME_S
        is_hidden = (truth.times_s > began_s) & (truth.times_s < ended_s)
        is_shown = is_hidden & truth.is_fresh[:, truth.robot_index_of(fault)]
        if is_shown.any():
            at_s = float(truth.times_s[is_shown.argmax()])
            yield Violation("untrue", at_s, f"the name {fault.fields['robot']} is not hidden")
            return


def _result_is_true(truth: Truth) -> Iterator[Violation]:
    """Check that no error in the result of a complete trial is wrong by more than RESULT_MM.

    A trial without a log or result is not checked.
    """
    log = truth.trial
    if log is None or log.result is None or not log.result.outcome.complete:
        return
    most_mm = float(_result_errors_mm(truth, log.result.robot_errors).max())
    if most_mm > RESULT_MM:
        finding = f"the result is wrong by {most_mm:.0f} mm"
        at_s = float(truth.times_s[-1])
        yield Violation("untrue", at_s, finding)


def _result_errors_mm(truth: Truth, robot_errors: Sequence[float]) -> Floats:
    """Compare each robot's error in a result with the nearest true error, shape (N,).

    True errors in the last `stale` before the last frame are compared, because a robot that is
    moved by hand at the end is known by its earlier pose.
    """
    final_s = truth.times_s[truth.final_exposure]
    is_recent = (truth.times_s > final_s - truth.limits.stale) & (truth.times_s <= final_s)
    to_targets = truth.poses[is_recent, :, :2] / truth.unit_mm - truth.setup.targets.reshape(-1, 2)
    differences = np.hypot(to_targets[..., 0], to_targets[..., 1]) - robot_errors
    return np.abs(differences).min(axis=0) * truth.unit_mm


# When no camera can show a robot


def hiding_faults(truth: Truth) -> Iterator[VisibleFault]:
    """Yield the faults that hide a robot from the camera.

    The robot is untracked, or lifted or tipped by more than the spec and a camera's noise allow.
    Nothing is yielded if robots were swapped in the test run, because each is then shown as
    another.
    """
    if truth.had_fault("swap"):
        return
    limits = truth.limits
    for fault in truth.faults:
        fields = fault.fields
        is_untracked = fault.name in ("untracked", "nan", "bad_quaternion")
        is_high = fields.get("height", 0.0) > _highest_mm(truth, fault) + NOISE_MM
        tilt_max = limits.tilt + TILT_NOISE_RAD
        is_tilted = fault.name == "tipped" and abs(fields["angle"]) > tilt_max
        if is_untracked or is_high or is_tilted:
            yield fault


def _highest_mm(truth: Truth, fault: VisibleFault) -> float:
    """Compute the maximum height at which a body may be seen [mm].

    If the fault begins while the robot drives in a run, it is LIFTED_MM above the body's place on
    the robot.
    """
    limit_mm = truth.limits.height_mm[1]
    if fault.span.began_s <= truth.first_event_s("run"):
        return limit_mm
    return min(limit_mm, BODY_MM + LIFTED_MM)


INVARIANTS: tuple[Invariant, ...] = (
    driven_blind,
    rests_after_a_stop,
    stays_inside,
    poses_are_true,
    log_is_readable,
    exit_code_is_right,
    reason_names_a_fault,
)
