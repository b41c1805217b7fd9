"""Tests of labs with one real device: displaced poses, and an actuator with an emulated twin."""

import threading
from types import SimpleNamespace

import pytest
from testkit.hand_clock import HandClock
from testkit.labs import FakeActuator, fake_lab
from testkit.trials import experiment
from tetractl_emulator.half_real import HISTORY_NS, Blind, MovedCamera, TwinActuator

from tetractl.core.clock import MILLISECOND, SECOND
from tetractl.core.errors import AbortError
from tetractl.core.poses import CameraFrame, Pose
from tetractl.lab.inner_loop import InnerLoop
from tetractl.spec.lab_section import STOP_COUNT


def test_an_emulated_radio_that_fails_keeps_no_stop_from_the_real_robots():
    """Regression: the loop took its error for one of the real radio, and left out the nine stops
    that were still to be sent."""
    lab = fake_lab(experiment().setup)
    lab.plant.open()
    lab.clock.steps.remove(lab.plant.rig.loop.step)  # the loop below is the only one
    emulated = FakeActuator(lab.world, failure="the port of the emulated radio is gone")
    both = TwinActuator(lab.actuator, emulated)
    guard = lab.plant.rig.loop.guard
    loop = InnerLoop(lab.camera, both, guard, lab.clock, threading.Event(), threading.Event())
    first = loop.stop()
    stops = lab.actuator.sent
    assert len(stops) == STOP_COUNT
    assert first is stops[0]


class RealCamera:
    """Stands for a camera above two robots that stand still: green is tracked, blue is given."""

    damaged = 7

    def __init__(self):
        self.waiting = []
        self.open = False

    def __enter__(self):
        self.open = True

    def __exit__(self, *reason):
        self.open = False

    def check(self):
        return "healthy"

    def frames(self):
        frames, self.waiting = self.waiting, []
        return frames


class MovedBody:
    """Stands for an emulated robot, in mm."""

    def __init__(self):
        self.x, self.y, self.heading = 0.0, 0.0, 0.0

    def place(self, x, y, heading):
        self.x, self.y, self.heading = x, y, heading


class HalfReal:
    """A displaced camera whose spec counts in cm, with two emulated robots and a clock."""

    mm = 10.0

    def __init__(self):
        self.real = RealCamera()
        self.bodies = [MovedBody(), MovedBody()]
        self.actuator = SimpleNamespace(bodies=self.bodies, driven=False)
        self.clock = HandClock()
        emulation = SimpleNamespace(actuator=self.actuator)
        self.camera = MovedCamera(self.real, emulation, self.clock, self.mm)

    def shown(self, *poses, exposed_ns=(), sampled_ns=None):
        """The poses that the program sees when the real camera shows these."""
        now_ns = self.clock.now() if sampled_ns is None else sampled_ns
        self.real.waiting.append(CameraFrame(1, now_ns, now_ns, poses, exposed_ns=exposed_ns))
        (frame,) = self.camera.frames()
        return frame.poses

    def drives(self, x, y, heading, robot=0):
        """An emulated robot is driven for 10 ms to a place [mm]."""
        self.clock.advance_ns(10 * MILLISECOND)
        self.actuator.driven = True
        self.bodies[robot].place(x, y, heading)
        self.camera.look()


GREEN = Pose(40.0, 30.0, 0.5, height=6.0, tilt=0.1)
BLUE = Pose(80.0, 20.0, -1.0)


def test_until_they_drive_emulated_robots_stand_where_the_camera_sees_the_real_ones():
    lab = HalfReal()
    assert lab.shown(GREEN, None) == (GREEN, None)
    lab.camera.look()
    (green, blue) = lab.bodies
    assert (green.x, green.y, green.heading) == (400.0, 300.0, 0.5)
    assert (blue.x, blue.y, blue.heading) == (0.0, 0.0, 0.0)
    assert lab.shown(None, BLUE) == (None, BLUE)
    lab.camera.look()
    assert (blue.x, blue.y, blue.heading) == (800.0, 200.0, -1.0)
    assert (green.x, green.y) == (400.0, 300.0)


def test_a_pose_is_displaced_by_the_way_and_the_turn_of_its_emulated_robot():
    lab = HalfReal()
    lab.shown(GREEN, BLUE)
    lab.camera.look()
    lab.drives(450.0, 270.0, 0.9)
    noisy = Pose(40.2, 29.9, 0.52, height=6.0, tilt=0.1)
    green, blue = lab.shown(noisy, BLUE)
    assert (green.x, green.y, green.heading) == pytest.approx((45.2, 26.9, 0.92))
    assert (green.height, green.tilt) == (6.0, 0.1)
    assert (blue.x, blue.y, blue.heading) == pytest.approx((80.0, 20.0, -1.0))


def test_robots_that_stop_again_are_not_put_back_to_where_the_real_ones_stand():
    lab = HalfReal()
    lab.shown(GREEN, BLUE)
    lab.camera.look()
    lab.drives(450.0, 270.0, 0.9)
    lab.actuator.driven = False
    lab.clock.advance_ns(10 * MILLISECOND)
    lab.camera.look()
    assert (lab.bodies[0].x, lab.bodies[0].y) == (450.0, 270.0)
    green, _ = lab.shown(GREEN, BLUE)
    assert (green.x, green.y) == pytest.approx((45.0, 27.0))


def test_a_robot_without_a_pose_or_without_a_place_before_it_drove_has_none():
    lab = HalfReal()
    lab.shown(GREEN, None)
    lab.camera.look()
    lab.drives(450.0, 270.0, 0.9)
    assert lab.shown(GREEN, BLUE)[1] is None
    assert lab.shown(None, BLUE) == (None, None)


def test_a_frame_is_displaced_as_of_the_time_at_which_each_of_its_poses_was_measured():
    lab = HalfReal()
    lab.shown(GREEN, BLUE)
    lab.camera.look()
    for step in range(1, 6):  # 1 mm every 10 ms
        lab.drives(400.0 + step, 300.0, 0.5)
    cases = {0: 0.0, 10: 1.0, 19: 1.0, 20: 2.0, 50: 5.0, 80: 5.0}
    for sampled_ms, way_mm in cases.items():
        green, _ = lab.shown(GREEN, BLUE, sampled_ns=sampled_ms * MILLISECOND)
        assert green.x * 10 - 400.0 == pytest.approx(way_mm)
    own_times = (30 * MILLISECOND, 50 * MILLISECOND)
    green, _ = lab.shown(GREEN, BLUE, exposed_ns=own_times)
    assert green.x * 10 - 400.0 == pytest.approx(3.0)


def test_an_older_frame_than_is_remembered_is_displaced_as_of_the_oldest_memory():
    lab = HalfReal()
    lab.shown(GREEN, BLUE)
    lab.camera.look()
    lab.drives(410.0, 300.0, 0.5)  # at 10 ms
    lab.clock.advance_ns(HISTORY_NS)
    lab.bodies[0].place(420.0, 300.0, 0.5)
    lab.camera.look()
    green, _ = lab.shown(GREEN, BLUE, sampled_ns=5 * MILLISECOND)
    assert green.x * 10 == pytest.approx(410.0)  # of the start, nothing is remembered
    green, _ = lab.shown(GREEN, BLUE, sampled_ns=10 * MILLISECOND)
    assert green.x * 10 == pytest.approx(410.0)


def test_health_and_damage_are_those_of_the_real_camera_which_opens_and_closes_with_it():
    lab = HalfReal()
    assert lab.camera.check() == "healthy"
    assert lab.camera.damaged == 7
    with lab.camera:
        assert lab.real.open
    assert not lab.real.open


def test_a_blind_camera_shows_nothing_and_says_that_it_is_real():
    blind = Blind()
    assert blind.open(None) == {"camera": "real"}
    assert blind.close() == {}
    assert not blind.shown_ns


class Sender:
    """Stands for an actuator that keeps what is sent, and may fail."""

    halts = True
    period_ns = 20 * MILLISECOND

    def __init__(self, name, failure=None):
        self.name = name
        self.failure = failure
        self.calls = []

    def __enter__(self):
        self._do("enter")

    def __exit__(self, *_):
        self._do("exit")

    def check(self):
        return f"health of the {self.name} one"

    def send(self, *arguments):
        return self._do("send", *arguments)

    def stop(self, emergency=False):
        return self._do("stop", emergency)

    def poll(self, timeout_s):
        return self._do("poll", timeout_s)

    def _do(self, *call):
        self.calls.append(call)
        if self.failure and call[0] in ("send", "stop"):
            raise AbortError(self.failure)
        return f"{call[0]} of the {self.name} one"


def twins(**failures):
    real = Sender("real", failures.get("real"))
    twin = Sender("emulated", failures.get("emulated"))
    return TwinActuator(real, twin), real, twin


def test_both_actuators_get_each_action_and_the_real_one_answers():
    both, real, twin = twins()
    with both:
        assert both.send("ahead", ["pose"], [True], 5) == "send of the real one"
        assert both.stop(True) == "stop of the real one"
        assert both.stop() == "stop of the real one"
        assert both.poll(0.5) == "poll of the real one"
    sent = [("send", "ahead", ["pose"], [True], 5), ("stop", True), ("stop", False)]
    assert real.calls == [("enter",), *sent, ("poll", 0.5), ("exit",)]
    assert twin.calls == [("enter",), *sent, ("exit",)]
    assert both.check() == "health of the real one"
    assert both.failure is None
    assert (both.halts, both.period_ns) == (True, 20 * MILLISECOND)


def test_emulated_robots_are_stopped_though_the_real_radio_is_gone():
    both, _, twin = twins(real="unplugged")
    assert both.failure == "unplugged"
    with pytest.raises(AbortError, match="unplugged"):
        both.stop(True)
    assert twin.calls == [("stop", True)]


def test_a_failure_of_the_emulated_radio_is_none_of_the_real_one():
    both, _, _ = twins(emulated="gone")
    assert both.failure is None
    assert both.stop() == "stop of the real one"
    with pytest.raises(AbortError, match="gone"):
        both.send("ahead", [], [], SECOND)
