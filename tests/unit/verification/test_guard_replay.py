"""Tests of what a guard says about a trial when it sees the log of the trial again."""

from dataclasses import replace

import numpy as np
import pytest
from testkit.trials import THREE_M3PI, three_robots

from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, Steer, Stop, Turn
from tetractl.lab.guard_observer import Action
from tetractl.log.read.reader import read_trial
from tetractl.run.logged_trial import log_path, run_logged
from tetractl.spec.lab_section import LabLimits
from tetractl.spec.load import parse_contents
from tetractl.verification.guard_replay import (
    COMMON_CHECKS,
    TICK_NS,
    WHEEL_CHECKS,
    camera_frame,
    lab_limits,
    observe_log,
    ordered_events,
)

pytestmark = pytest.mark.slow

LENIENT = {"wheel_error": 1.0, "drift": 1e9}
"""Limits of the checks of motion that no robot reaches: a simulation logs wheel speeds only at the
start of each period, in which the robots turn on."""
LIMITS = LabLimits(**LENIENT)
PERIOD_NS = SECOND // 5
STEPS_MAX = 8


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """Three robots on wheels that drive for 1.8 s and do what they are sent."""
    controller = THREE_M3PI["controller"] | {"steps_max": STEPS_MAX, "motion": "exact"}
    contents = THREE_M3PI | {"wheels": {"radius": 40}, "obstacles": [], "controller": controller}
    folder = tmp_path_factory.mktemp("log")
    run_logged(parse_contents(contents, "wheels.yaml", ()), folder)
    return read_trial(log_path(folder, 0))


def with_rows(log, kept):
    """The log with some of its frames."""
    names = ("frames", "mocap_ns", "received_ns", "mocap", "valid", "truth", "exposed_ns")
    arrays = {name: getattr(log, name) for name in names}
    return replace(log, **{n: None if a is None else a[kept] for n, a in arrays.items()})


def acts_of(log, **limits):
    """Time [s], act, check and robot of each intervention."""
    seen = observe_log(log, LabLimits(**LENIENT | limits))
    return [(it.t_ns / SECOND, it.act, it.check, it.robot) for it in seen.interventions]


def test_robots_that_obey_are_left_alone_from_the_first_direction_to_the_stop(log):
    report = observe_log(log, LIMITS)
    assert report.interventions == ()
    driven_s = (log.stop.sent_ns - log.steps[0].command.sent_ns) / SECOND
    assert report.watched_s == pytest.approx(driven_s, abs=1 / 120 + 1e-6)
    assert report.began_ns == log.began_ns


def test_wheels_are_checked_only_if_the_log_has_their_speeds(log):
    assert observe_log(log, LIMITS).checks == COMMON_CHECKS + WHEEL_CHECKS
    assert observe_log(with_rows(three_robots(), slice(0, 30)), LIMITS).checks == COMMON_CHECKS


def test_without_limits_those_of_the_log_count(log):
    assert lab_limits(log) == LabLimits()
    report = observe_log(log)
    assert report == observe_log(log, LabLimits())
    assert report.interventions


def test_the_guard_decides_in_each_hundredth_of_a_second_without_any_frame(log):
    """Otherwise a stop would have the time of the next command or frame."""
    last_ns = int(log.received_ns[log.received_ns < 0.43 * SECOND][-1])
    kept = (log.received_ns <= last_ns) | (log.received_ns > 1.5 * SECOND)
    silent = with_rows(log, kept)
    tick_s = TICK_NS / SECOND
    for stale_s in (0.05, 0.13):
        acts = acts_of(silent, stale=stale_s)
        stops = [act for act in acts if act[1] is Action.STOPS]
        assert {robot for *_, robot in stops} == {"green", "blue", "red"}
        for stopped_s, _, check, _ in stops:
            assert check == "frame"
            assert 0 <= stopped_s - last_ns / SECOND - stale_s <= tick_s + 1e-6
    (end,) = [act for act in acts if act[1] is Action.ENDS][:1]
    assert 0 <= end[0] - last_ns / SECOND - 0.5 <= tick_s + 1e-6


def test_a_robot_that_is_not_valid_in_the_log_is_hidden_from_the_guard(log):
    valid = log.valid.copy()
    valid[50:75, 1] = False
    ((stopped_s, *act),) = acts_of(replace(log, valid=valid))
    assert act == [Action.STOPS, "tracking", "blue"]
    assert log.received_ns[50] / SECOND < stopped_s < log.received_ns[74] / SECOND


def test_control_steps_in_a_row_that_were_late_end_the_run_at_the_last_of_them(log):
    late = [replace(step, deadline_missed=step.k in (2, 3, 4)) for step in log.steps]
    slow = replace(log, steps=tuple(late))
    assert acts_of(slow, late_steps=4) == []
    ((ended_s, act, check, robot),) = acts_of(slow, late_steps=3)
    assert (act, check, robot) == (Action.ENDS, "late steps", "")
    assert ended_s == log.steps[4].command.sent_ns / SECOND


def test_commands_before_the_first_step_start_no_run(log):
    """In a lab, robots are turned and driven before the trial."""
    before = [Command(Steer(0.3), k * PERIOD_NS, (True,) * 3) for k in (2, 3)]
    later_ns = 5 * PERIOD_NS
    steps = [step for step in log.steps if step.command.sent_ns >= later_ns]
    sent = [command for command in log.commands if command.sent_ns >= later_ns]
    late = replace(log, steps=tuple(steps), commands=(*before, *sent))
    report = observe_log(late, LIMITS)
    driven_s = (log.stop.sent_ns - later_ns) / SECOND
    assert report.watched_s == pytest.approx(driven_s, abs=1 / 120 + 1e-6)


def test_in_a_log_without_steps_every_command_is_of_the_run_and_a_stop_ends_it(log):
    """As in recordings of other programs."""
    half = PERIOD_NS * 4
    commands = [command for command in log.commands if command.sent_ns < half]
    stopped = replace(log, steps=(), commands=(*commands, Command(Stop(), half, (True,) * 3)))
    report = observe_log(stopped, LIMITS)
    assert report.watched_s == pytest.approx(half / SECOND, abs=1 / 120 + 1e-6)


def test_after_a_stop_outside_of_the_steps_nothing_is_watched(log):
    half = PERIOD_NS * 4
    commands = [command for command in log.commands if command.sent_ns < half]
    steps = [step for step in log.steps if step.command.sent_ns < half]
    stop = Command(Stop(), half, (True,) * 3)
    stopped = replace(log, steps=tuple(steps), commands=(*commands, stop))
    report = observe_log(stopped, LIMITS)
    assert report.watched_s == pytest.approx(half / SECOND, abs=1 / 120 + 1e-6)
    turned = replace(stopped, commands=(*commands, replace(stop, action=Turn(0.0))))
    assert observe_log(turned, LIMITS).watched_s > report.watched_s


def test_frames_and_commands_come_in_the_order_of_their_times_and_a_frame_first(log):
    events = ordered_events(log)
    assert [event.t_ns for event in events] == sorted(event.t_ns for event in events)
    assert len(events) == len(log.frames) + len(log.commands)
    at_start = [event.is_command for event in events if event.t_ns == 0]
    assert at_start == [False, True]
    rows = [event.row for event in events if event.is_command]
    assert rows == list(range(len(log.commands)))


def test_events_have_the_time_at_which_the_host_received_a_frame(log):
    late = replace(log, received_ns=log.received_ns + 7_000_000)
    first = ordered_events(late)[:2]
    assert [(event.t_ns, event.is_command) for event in first] == [(0, True), (7_000_000, False)]


def test_a_frame_has_the_logged_poses_of_the_robots_that_were_tracked(log):
    valid = log.valid.copy()
    valid[5, 2] = False
    late = replace(log, valid=valid, received_ns=log.received_ns + 7)
    frame = camera_frame(late, 5)
    green, blue, red = frame.poses
    assert red is None
    assert [green.x, green.y, green.heading] == log.mocap[5, 0].tolist()
    assert [blue.x, blue.y, blue.heading] == log.mocap[5, 1].tolist()
    times = (frame.sampled_ns, frame.received_ns)
    assert times == (log.mocap_ns[5], log.mocap_ns[5] + 7)
    assert frame.number == log.frames[5]


def test_logged_wheel_speeds_are_checked_and_others_are_not(log):
    """Robots that stand although their wheels turn are noticed by the wheel speeds alone."""
    start = np.broadcast_to(log.mocap[0], log.mocap.shape) + 1e-3 * np.sin(
        np.arange(log.mocap.size).reshape(log.mocap.shape)
    )
    standing = replace(log, mocap=start)
    noticed = {it.check for it in observe_log(standing, LabLimits()).interventions}
    assert noticed & set(WHEEL_CHECKS)
    unknown = [replace(command, left=None, right=None) for command in log.commands]
    blind = observe_log(replace(standing, commands=tuple(unknown)), LabLimits())
    assert blind.checks == COMMON_CHECKS
