"""Tests of the inner loop when its other thread hangs. Tests of the plant cover the rest."""

import math
import threading
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from testkit.labs import STEP_NS, fake_lab
from testkit.trials import experiment

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.commands import Steer
from tetractl.core.errors import AbortError
from tetractl.core.guard_findings import Lose
from tetractl.core.poses import CameraFrame, Pose
from tetractl.lab import inner_loop
from tetractl.lab.guard import GuardState


@pytest.fixture
def lab():
    """A lab whose robots drive."""
    driving = fake_lab(experiment().setup)
    driving.plant.open()
    driving.plant.send(Steer(0.5))
    return driving


def wait_a_second(lab):
    lab.clock.sleep_until(lab.clock.now() + SECOND)


class FailedStop(NamedTuple):
    """A stop that an actuator was asked for and failed at."""

    sent_ns: int
    emergency: bool


def fail_at_stops(lab, error):
    """Let the actuator raise this at each stop; return the stops, which go on to be added."""
    stops = []

    def fail(emergency=False):
        stops.append(FailedStop(lab.clock.now(), emergency))
        raise error

    lab.actuator.stop = fail
    return stops


@pytest.fixture
def hung(lab, monkeypatch):
    """A running lab whose loop hangs in a step of its own thread: the camera returns no frames."""
    monkeypatch.setattr(inner_loop, "STOP_TIMEOUT_S", 0.01)
    loop = lab.plant.rig.loop
    lab.clock.steps.remove(loop.step)
    entered = threading.Event()
    given_back = threading.Event()

    def hang():
        entered.set()
        given_back.wait(60)
        return []

    lab.camera.frames = hang
    thread = threading.Thread(target=loop.step, daemon=True)
    thread.start()
    assert entered.wait(60)
    yield lab
    given_back.set()
    thread.join(60)


def test_steering_past_a_loop_that_hangs_aborts(hung):
    with pytest.raises(AbortError, match="the inner loop did not answer"):
        hung.plant.send(Steer(0.1))
    assert hung.plant.rig.loop.guard.state is GuardState.ABORT


def test_a_stop_is_sent_past_a_loop_that_hangs(hung):
    before = len(hung.actuator.sent)
    first = hung.plant.rig.loop.stop()
    stops = hung.actuator.sent[before:]
    assert first is stops[0]
    assert [sent.direction for sent in stops] == [None] * 10
    assert stops[-1].sent_ns - stops[0].sent_ns == pytest.approx(180_000_000, abs=20_000_000)
    assert hung.world.moving == (False,) * 3


def press_the_key(lab):
    lab.supervision.emergency.set()


def abort_by_the_operator(lab):
    lab.plant.rig.loop.guard.abort("emergency stop by the operator", emergency=True)


@pytest.mark.parametrize("ask", [press_the_key, abort_by_the_operator])
def test_an_emergency_stop_past_a_loop_that_hangs_is_one_to_the_devices(hung, ask):
    """Regression: only steps of the loop read the key, and only its own stops said that devices are
    to latch them: the stops that were sent past one were no emergency stops."""
    before = len(hung.actuator.sent)
    ask(hung)
    hung.plant.rig.loop.stop()
    assert hung.actuator.emergencies == len(hung.actuator.sent) - before == 10


def test_a_robot_that_must_stop_is_not_steered_until_the_next_period():
    lab = fake_lab(experiment().setup, period_ns=SECOND // 4)
    lab.plant.open()
    lab.plant.send(Steer(0.5))
    lab.clock.sleep_until(lab.clock.now() + SECOND // 100)
    lab.camera.hidden.add("blue")
    hidden = lab.clock.now()
    lab.clock.sleep_until(hidden + SECOND // 4)
    first = next(sent for sent in lab.actuator.sent if sent.delivered == (True, False, True))
    assert first.sent_ns - hidden < 80_000_000  # 50 ms of limits.untracked_stop, and some frames


def test_a_loop_that_is_not_ready_steers_nothing():
    lab = fake_lab(experiment().setup)
    refused = pytest.raises(AbortError, match="the guard lets no robot be steered")
    with lab.plant.rig as rig, refused:
        rig.loop.hold(Steer(0.1))
    assert lab.actuator.sent == []


def test_robots_are_stopped_before_it_is_asked_who_is_at_fault(lab, monkeypatch):
    """Regression: finding the cause takes some 10 ms, and the stop waited for it."""
    guard = lab.plant.rig.loop.guard
    sent = []

    class Asked:
        """Stands for the search for the cause; it looks what was sent last when it is asked."""

        def __init__(self, rules, drift, frames):
            assert frames

        def explain(self, suspect, reason):
            sent.append(lab.actuator.sent[-1].direction)
            return "the camera"

    monkeypatch.setattr("tetractl.lab.guard.AbortCause", Asked)
    guard.abort("green moves in a way that no command explains", suspect=0)
    lab.plant.rig.loop.step()
    lab.plant.rig.loop.step()
    assert sent == [None]  # asked once, after a stop
    assert guard.reason == "the camera"


UNTIMELY = {"sent_ns": -5}, {"sent_ns": 10**18}
SPEEDS = {"left": np.array([math.nan] * 3)}, {"left": np.zeros(1)}


@pytest.mark.parametrize("change", [*SPEEDS, {"sent_ns": 1.5}, None, *UNTIMELY])
def test_a_transmission_that_no_log_can_hold_stops_the_robots(lab, change):
    """Regression: exit 0, and a log that could not be read."""
    send = lab.actuator.send
    lab.actuator.send = lambda *a: None if change is None else replace(send(*a), **change)
    text = "was sent at .* ns, but this time must be" if change in UNTIMELY else "cannot be logged"
    with pytest.raises(AbortError, match=f"an actuator returned a transmission that {text}"):
        lab.plant.send(Steer(0.6))
    assert lab.actuator.sent[-1].direction is None  # a stop


NO_FRAME = "frame that cannot be logged"
SPOILT = {  # a frame of a number at a time, received at another, and what is said of it
    "nan": (CameraFrame(10**6, 0, 0, (Pose(math.nan, 0.0, 0.0), None, None)), NO_FRAME),
    "inf": (CameraFrame(10**6, 0, 0, (Pose(math.inf, 0.0, 0.0), None, None)), NO_FRAME),
    "1e300": (CameraFrame(10**6, 0, 0, (Pose(1e300, 0.0, 0.0), None, None)), NO_FRAME),
    "a number of 70 bits": (CameraFrame(2**70, 0, 0, (None,) * 3), NO_FRAME),
    "no whole number": (CameraFrame(1.5, 0, 0, (None,) * 3), NO_FRAME),
    "received before its exposure": (
        CameraFrame(10**6, 10**18, 0, (None,) * 3),
        "frame that was received ",
    ),
    "a pose that is later": (
        CameraFrame(10**6, 0, 0, (None,) * 3, exposed_ns=(0, 0, 1)),
        "pose that was exposed later than its frame",
    ),
}


@pytest.mark.parametrize("case", SPOILT)
def test_a_frame_that_cannot_be_stops_the_robots(lab, case):
    """Regression: a camera's NaN came into the log, which could not be read, or `verify` refused
    it."""
    spoilt, says = SPOILT[case]
    frames = lab.camera.frames
    lab.camera.frames = lambda: [*frames(), spoilt]
    lab.plant.rig.loop.step()
    guard = lab.plant.rig.loop.guard
    assert guard.state is GuardState.ABORT
    assert f"a camera returned a {says}" in guard.reason
    assert lab.actuator.sent[-1].direction is None  # a stop


@pytest.fixture
def blind(lab):
    """A lab a second after its camera began to raise in each step, while robots drove."""

    def frames():
        raise AbortError("the camera is gone")

    lab.camera.frames = frames
    wait_a_second(lab)
    return lab


def test_a_camera_that_raises_for_good_stops_the_robots(blind):
    """Regression: the stop was left to the next step, which failed before it: robots drove on."""
    assert blind.plant.rig.loop.guard.reason == "the camera is gone"
    assert [sent.direction for sent in blind.actuator.sent[-10:]] == [None] * 10
    assert blind.world.moving == (False,) * 3


def test_an_emergency_stop_is_sent_after_an_abort_too(lab):
    lab.plant.rig.loop.guard.abort("another fault")
    wait_a_second(lab)
    assert lab.actuator.emergencies == 0
    lab.supervision.emergency.set()
    wait_a_second(lab)
    assert lab.actuator.emergencies == 10
    assert lab.plant.rig.loop.guard.reason == "another fault"


def test_the_operators_key_is_obeyed_after_an_emergency_stop_of_the_program(lab):
    """Regression: stops that the camera had asked for had ended, and the key sent none."""
    lab.plant.rig.loop.guard.abort("blue moves after a stop", emergency=True)
    wait_a_second(lab)
    assert lab.actuator.emergencies == 10
    wait_a_second(lab)
    assert lab.actuator.emergencies == 10
    lab.supervision.emergency.set()
    wait_a_second(lab)
    assert lab.actuator.emergencies == 20
    wait_a_second(lab)
    assert lab.actuator.emergencies == 20


def test_a_failed_port_leaves_the_robots_at_other_ports_their_ten_stops(lab):
    """Regression: the first stop that a port did not take ended the series, though the actuator had
    written it to the ports of the other robots: they got one stop of each ten."""
    stops = fail_at_stops(lab, AbortError("green's port is gone"))
    lab.plant.rig.loop.guard.abort("another fault")
    wait_a_second(lab)
    assert len(stops) == 10
    assert lab.plant.rig.loop.stop() is None
    assert len(stops) == 20
    lab.supervision.emergency.set()
    wait_a_second(lab)
    assert [stop.emergency for stop in stops] == [False] * 20 + [True] * 10


class LosesBlue:
    """Stands for a camera's watch to which blue is lost."""

    def see(self, sampled_ns):
        yield from ()

    def lost(self):
        yield Lose(1, "blue is another robot")

    def replace(self, robot):
        return ""


def test_the_controller_loses_no_robot_while_the_loop_is_within_a_step(hung):
    """Regression: its thread changed the guard at any time, also while a step was deciding by it;
    a warning given meanwhile could be lost."""
    hung.camera.watch = lambda setup, limits: LosesBlue()
    with pytest.raises(AbortError, match="the inner loop did not answer"):
        hung.plant.observe()


def test_a_guard_of_newly_found_robots_does_not_wait_for_a_loop_that_hangs(hung):
    """Regression: it waited without a limit."""
    with pytest.raises(AbortError, match="the inner loop did not answer"):
        hung.plant.rig.loop.restart(hung.plant.rig.loop.guard.rules)


def test_a_guard_of_other_rules_has_the_checks_of_the_one_before():
    """Regression: a robot faster than its spec was refused as a jump while it was calibrated."""
    loop = fake_lab(experiment().setup).plant.rig.loop
    before = loop.guard
    faster = replace(before.rules, speeds=(2000.0, 100.0, 100.0))
    loop.restart(faster)
    assert loop.guard is not before
    assert loop.guard.rules is faster
    assert loop.guard.checks_of is before.checks_of


def test_a_stop_past_a_loop_that_hangs_never_raises(hung):
    """Regression: errors of an actuator's own code ended it after the first stop."""
    stops = fail_at_stops(hung, ValueError("a defect of the actuator"))
    assert hung.plant.rig.loop.stop() is None
    assert len(stops) == 10


def test_the_abort_of_a_new_guard_has_stops_of_its_own(lab):
    """Regression: a loop sent the stops of an abort once, whichever guard it was of."""
    loop = lab.plant.rig.loop
    loop.guard.abort("the first")
    wait_a_second(lab)
    lab.plant.rig.settle(lab.plant.rig.setup)
    before = len(lab.actuator.sent)
    loop.guard.abort("the second")
    wait_a_second(lab)
    assert len(lab.actuator.sent) == before + 10


def test_what_was_written_slowly_is_not_repeated_within_half_a_period(monkeypatch):
    """Regression: half a period was counted from the step's begin, so that on a busy computer two
    transmissions came within 1 ms, and `verify` called an honest log false."""
    lab = fake_lab(experiment().setup, period_ns=SECOND // 40)
    lab.plant.open()
    send = lab.actuator.send

    def send_late(*arguments):
        if len(lab.actuator.sent) % 3 == 2:
            VirtualClock.sleep_until(lab.clock, lab.clock.now() + SECOND // 50)
        return send(*arguments)

    monkeypatch.setattr(lab.actuator, "send", send_late)
    lab.plant.send(Steer(0.5))
    wait_a_second(lab)
    sent_ns = [sent.sent_ns for sent in lab.actuator.sent]
    assert min(np.diff(sent_ns)) >= SECOND // 80


def test_a_failure_that_is_no_text_stops_the_robots(lab):
    """Regression: no log could hold the reason, and the log stayed a .part."""
    lab.actuator.failure = 5
    lab.plant.rig.loop.step()
    assert (
        "an actuator returned a `failure` that is neither a string nor None"
        in lab.plant.rig.loop.guard.reason
    )


def test_the_emergency_key_is_obeyed_while_the_camera_raises_in_each_step(blind):
    """Regression: a step read the key after the camera's frames, so it was never obeyed while
    the camera raised: nothing was sent, and no device latched a stop."""
    assert blind.actuator.emergencies == 0
    pressed_ns = blind.clock.now()
    blind.supervision.emergency.set()
    wait_a_second(blind)
    stops = [sent for sent in blind.actuator.sent if sent.sent_ns > pressed_ns]
    assert blind.actuator.emergencies == len(stops) == 10
    assert stops[0].sent_ns - pressed_ns == STEP_NS  # in the next step
    assert blind.plant.rig.loop.guard.reason == "the camera is gone"


def test_a_port_that_fails_at_the_end_of_a_run_ends_no_stops(lab):
    """Regression: the others got two stops. An abort at the first stop begins ten more."""
    stops = fail_at_stops(lab, AbortError("green's port is gone"))
    assert lab.plant.rig.loop.stop() is None
    wait_a_second(lab)
    sent_ns = [stop.sent_ns for stop in stops]
    assert len(sent_ns) == 11
    assert min(np.diff(sent_ns)) > 0
    assert sent_ns[-1] - sent_ns[0] < SECOND // 4
    assert lab.plant.rig.loop.guard.reason == "green's port is gone"


def test_the_guard_knows_the_directions_by_which_robots_turn_before_a_run():
    """Regression: cells still turned by them when the run started, and 6 of 8 trials in a dish said
    that they turn away from the field."""
    idle = fake_lab(experiment().setup)
    idle.plant.open()
    noted = []
    loop = idle.plant.rig.loop
    loop.guard.record_transmission = lambda *sent: noted.append(sent)
    loop.idle_direction = lambda now_ns: 1.0
    wait_a_second(idle)
    assert len(noted) > 5
    assert all(time_ns > 0 and len(speed) == len(turning) == 3 for time_ns, speed, turning in noted)
    assert loop.guard.state is GuardState.READY
