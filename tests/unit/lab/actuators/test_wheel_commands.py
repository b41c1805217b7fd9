"""Tests of polling robots on wheels, of their status messages, and of output units."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from testkit.hand_clock import HandClock
from testkit.trials import experiment

from tetractl.core.clock import MILLISECOND, SECOND
from tetractl.core.commands import Steer, Turn
from tetractl.core.poses import Pose
from tetractl.lab.actuators.wheel_commands import (
    BATTERY_EMPTY_V,
    POLLS_MAX,
    Reply,
    Status,
    WheeledActuator,
    poll_robots,
    radii_mm,
    robot_status,
    wheels_by_speed,
)

SLOT_MS = 20
SETUP = replace(experiment().setup, wheel_radius=40.0)


def reply(index, sequence=1, status=Status.RUNNING, battery_mv=5000):
    return Reply(index, sequence, status, battery_mv, 0, 0)


class Link:
    """Robots that reply after so many polls, to the poll or with another sequence number."""

    def __init__(self, clock, after=(1, 1), off=0, failure_at=99):
        self.clock = clock
        self.after = after
        self.off = off
        self.failure_at = failure_at
        self.asked = 0
        self.waited_s = 0.0

    @property
    def failure(self):
        return "unplugged" if self.asked >= self.failure_at else None

    def send_poll(self):
        self.asked += 1
        return self.asked, self.clock.now()

    def receive_replies(self, timeout_s):
        self.clock.advance(min(timeout_s, 0.03))
        self.waited_s += min(timeout_s, 0.03)
        return [
            reply(index, self.asked + self.off)
            for index, polls in enumerate(self.after)
            if self.asked >= polls
        ]


def poll(timeout_s=9.0, **robots):
    link = Link(HandClock(), **robots)
    return poll_robots(link, [0, 1], link.clock, timeout_s, SLOT_MS), link


def test_robots_that_reply_are_polled_once():
    replies, link = poll()
    assert [answer.id for answer in replies] == [0, 1]
    assert link.asked == 1


def test_robots_are_polled_again_until_each_has_replied():
    replies, link = poll(after=(1, 3))
    assert None not in replies
    assert link.asked == 3
    silent, link = poll(after=(1, 99))
    assert silent[0] is not None
    assert silent[1] is None
    assert link.asked == POLLS_MAX
    one_try_s = (1 + 2) * SLOT_MS / 1000 + 0.1
    assert link.waited_s == pytest.approx(POLLS_MAX * one_try_s)


@pytest.mark.parametrize(
    ("timeout_s", "tries"), [(0.01, 1), (0.33, 2), (0.5, 3), (60.0, POLLS_MAX)]
)
def test_as_many_polls_are_sent_as_the_time_allows_and_one_at_least(timeout_s, tries):
    _, link = poll(timeout_s, after=(99, 99))
    assert link.asked == tries


def test_a_reply_to_another_command_says_nothing():
    replies, link = poll(off=7)
    assert replies == [None, None]
    assert link.asked == POLLS_MAX


def test_a_link_that_failed_is_polled_no_more():
    replies, link = poll(after=(1, 99), failure_at=2)
    assert link.asked == 2
    assert replies[1] is None


@pytest.mark.parametrize(
    ("answer", "fields"),
    [
        (None, (False, None, 1, 0)),
        (reply(0), (True, 5.0, 0, 0)),
        (reply(0, battery_mv=0), (True, None, 0, 0)),
        (reply(0, battery_mv=4600), (True, 4.6, 0, 1)),  # low
        (reply(0, battery_mv=4700), (True, 4.7, 0, 0)),
        (reply(0, battery_mv=round(1000 * BATTERY_EMPTY_V)), (True, BATTERY_EMPTY_V, 0, 1)),
        (
            reply(0, battery_mv=round(1000 * BATTERY_EMPTY_V) - 1),
            (True, BATTERY_EMPTY_V - 0.001, 1, 0),
        ),
        (reply(0, status=Status.EMERGENCY_STOPPED, battery_mv=3000), (True, 3.0, 1, 0)),
        (reply(0, status=Status.SILENT), (True, 5.0, 0, 0)),
    ],
)
def test_a_robot_says_whether_it_can_drive(answer, fields):
    status = robot_status("green", answer, 4.7)
    found = status.answers, status.battery_v, len(status.problems), len(status.warnings)
    assert found == fields
    assert all("green" in line for line in (*status.problems, *status.warnings))


@pytest.mark.parametrize(("metres", "radius"), [(1e-3, 40.0), (1.0, 0.04)])
def test_radii_are_in_millimetres_whatever_the_unit_of_the_spec(metres, radius):
    setup = replace(SETUP, metres=metres, wheel_radius=radius)
    assert radii_mm(setup, [None, 55.0, None]) == pytest.approx([40.0, 55.0, 40.0])
    unknown = replace(setup, wheel_radius=None)
    assert np.isnan(radii_mm(unknown, [None, 55.0, None])).tolist() == [True, False, True]


class Wheels(WheeledActuator):
    """An actuator that keeps the outputs which it would send."""

    def __init__(self, setup, clock, delay_ns=0):
        link = SimpleNamespace(failure=None, open=lambda: None, close=lambda: None)
        gain = np.full((2, len(setup.names)), 2.0)  # [mm/s] per output
        drivetrains = wheels_by_speed(gain, 900.0)
        super().__init__(setup, clock, link, [None] * gain.shape[1], drivetrains, delay_ns, 40.0)
        self.sent = []

    def _drive(self, outputs):
        self.sent.append(outputs)
        return self._clock.now(), self._host.drivetrains.speeds(outputs)

    def _halt(self, emergency):
        return self._clock.now()


POSES = [Pose(0.0, 0.0, 0.3 * i) for i in range(len(SETUP.names))]
ALL = (True,) * len(POSES)


@pytest.mark.parametrize(("metres", "per_mm"), [(1e-3, 1.0), (1.0, 1e-3)])
def test_what_is_sent_is_in_the_units_of_the_spec(metres, per_mm):
    setup = replace(SETUP, metres=metres, wheel_radius=40 * per_mm, speed=SETUP.speed * per_mm)
    wheels = Wheels(setup, HandClock())
    sent = wheels.send(Steer(1.0), POSES, ALL, 0)
    for i, pose in enumerate(POSES):
        difference = SETUP.a[i] * 40.0 * math.sin(1.0 - pose.heading)
        assert sent.left[i] == pytest.approx((SETUP.speed[i] - difference) * per_mm, abs=2 * per_mm)
        assert sent.right[i] == pytest.approx(
            (SETUP.speed[i] + difference) * per_mm, abs=2 * per_mm
        )
        assert wheels.sent[0][:, i] * 2.0 * per_mm == pytest.approx([sent.left[i], sent.right[i]])
    assert wheels.period_ns == SECOND // 40


def test_robots_that_may_not_move_and_those_without_a_pose_stand():
    wheels = Wheels(SETUP, HandClock())
    wheels.send(Steer(1.0), [None, *POSES[1:]], (True, False, True), 0)
    assert not wheels.sent[0][:, :2].any()
    assert wheels.sent[0][:, 2].any()
    assert not wheels.stop().left.any()


def test_outputs_that_a_calibration_holds_are_sent_whatever_the_action():
    wheels = Wheels(SETUP, HandClock())
    wheels.held_outputs = np.array([[7, 8, 9], [-7, 0, 9]])
    wheels.send(Turn(0.0), POSES, (True, True, False), 0)
    assert wheels.sent[0].tolist() == [[7, 8, 0], [-7, 0, 0]]


def test_headings_are_predicted_by_the_delay_and_for_a_tenth_of_a_second_at_most():
    def turning(delay_ms):
        clock = HandClock()
        wheels = Wheels(replace(SETUP, lag_s=0.0), clock, delay_ms * MILLISECOND)
        for _ in range(2):
            clock.advance(0.5)
            sent = wheels.send(Steer(1.5), [Pose(0.0, 0.0, 0.0)] * 3, ALL, clock.now())
        return sent.turning[0] / SETUP.a[0]

    rate = turning(0)
    assert rate == pytest.approx(math.sin(1.5), abs=0.01)
    ahead = SETUP.a[0] * rate * 0.05
    assert turning(50) == pytest.approx(math.sin(1.5 - ahead), abs=0.02)
    assert turning(300) == pytest.approx(turning(100), abs=0.02)
