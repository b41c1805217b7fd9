"""Tests of the lab as a plant in virtual time, with a fake camera and a fake actuator."""

from dataclasses import replace

import pytest
from testkit.labs import fake_lab
from testkit.trials import experiment

from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, Steer, Stop
from tetractl.core.errors import AbortError
from tetractl.core.guard_findings import Lose
from tetractl.core.losses import LossRule
from tetractl.core.protocols import Health
from tetractl.core.trial import Note
from tetractl.lab.guard_checks import robot_checks
from tetractl.spec.lab_section import STOP_COUNT, LabLimits

pytestmark = pytest.mark.slow

PERIOD = SECOND // 5
SETUP = experiment().setup


def together(rules):
    return replace(robot_checks(rules), together=True)


CELLS = {"halts": False, "checks_of": together}


def opened(setup=SETUP, **actuator):
    lab = fake_lab(setup, **actuator)
    lab.plant.open()
    return lab


def drive(lab, seconds, direction=0.5):
    """Observe and steer once a control period."""
    began = lab.clock.now()
    for k in range(1, round(seconds * SECOND / PERIOD) + 1):
        lab.plant.observe()
        lab.plant.send(Steer(direction))
        lab.clock.sleep_until(began + k * PERIOD)


def driving(**actuator):
    """A lab whose robots have driven for two control periods."""
    lab = opened(**actuator)
    drive(lab, 0.4)
    return lab


def stopped(**actuator):
    """A lab whose robots have just been stopped."""
    lab = driving(**actuator)
    lab.plant.stop()
    return lab


def wait(lab, seconds):
    lab.clock.sleep_until(lab.clock.now() + round(seconds * SECOND))


def test_robots_that_can_only_stop_together_are_steered_on_while_one_is_not_tracked():
    lab = driving(**CELLS)
    lab.camera.hidden = {"green"}
    before = len(lab.actuator.sent)
    wait(lab, 0.2)
    after = lab.actuator.sent[before:]
    assert len(after) >= 5
    assert all(sent.direction == 0.5 for sent in after)
    observed = lab.plant.observe()
    assert observed.valid.tolist() == [False, True, True]
    lab.camera.hidden = set()
    wait(lab, 0.1)
    assert lab.plant.observe().valid.all()


@pytest.mark.parametrize("actuator", [{}, CELLS], ids=["robots", "cells"])
def test_a_robot_lost_for_too_long_aborts_and_stops_all(actuator):
    lab = driving(**actuator)
    lab.camera.hidden = {"blue"}
    wait(lab, 0.5)
    with pytest.raises(AbortError, match="blue is not tracked"):
        lab.plant.observe()
    with pytest.raises(AbortError, match="blue is not tracked"):
        lab.plant.send(Steer(0.1))
    stops = [sent for sent in lab.actuator.sent if sent.direction is None]
    assert len(stops) >= 5
    lab.plant.stop()
    assert lab.actuator.sent[-1].direction is None


def test_a_silent_camera_stops_cells_by_a_stop_and_the_run_goes_on_with_its_frames():
    lab = driving(**CELLS)
    lab.camera.silent = True
    wait(lab, 0.2)
    assert lab.actuator.sent[-1].direction is None
    lab.plant.observe()
    held = lab.plant.send(Steer(1.0))
    assert (held.direction, held.delivered) == (1.0, (False,) * 3)
    lab.camera.silent = False
    wait(lab, 0.1)
    assert lab.actuator.sent[-1].direction == 1.0
    lab.camera.silent = True
    wait(lab, 0.6)
    with pytest.raises(AbortError, match="no new camera frame for"):
        lab.plant.observe()


class Watch:
    """Stands for a camera's watch to which blue is lost, and replaced by `instead`."""

    def __init__(self, instead):
        self.instead = instead
        self.seen = []

    def see(self, sampled_ns):
        self.seen.append(sampled_ns)
        if len(self.seen) == 1:
            yield Note(sampled_ns, "warning", "blue is hard to see")

    def lost(self):
        yield Lose(1, "blue is another robot")

    def replace(self, robot):
        return self.instead


@pytest.mark.parametrize(
    ("loss", "instead", "says", "lost"),
    [
        (LossRule(0.0, False), "", ["blue is hard to see"], [1]),
        (LossRule(0.0, True), "", ["blue is hard to see"], [1]),
        (
            LossRule(0.0, True),
            "is now a red robot",
            ["blue is hard to see", "blue is now a red robot"],
            [],
        ),
    ],
)
def test_a_robot_that_counts_as_lost_for_its_camera_is_left_out_or_replaced(
    loss, instead, says, lost
):
    lab = fake_lab(replace(SETUP, loss=loss))
    watch = Watch(instead)
    lab.camera.watch = lambda setup, limits: watch
    lab.plant.open()
    lab.plant.observe()
    texts = [note.text for note in lab.plant.events() if isinstance(note, Note)]
    assert list(lab.plant.rig.loop.guard.lost_robots) == lost
    assert texts == says


def test_a_robot_is_not_replaced_before_it_has_been_lost_for_the_time_of_the_spec():
    lab = fake_lab(replace(SETUP, loss=LossRule(5.0, True)))
    lab.clock.sleep_until(10 * SECOND)
    lab.camera.watch = lambda setup, limits: Watch("is now a red robot")
    lab.plant.open()
    lab.plant.observe()
    assert list(lab.plant.rig.loop.guard.lost_robots) == [1]


def test_a_long_first_plan_is_no_late_step():
    lab = fake_lab(SETUP, LabLimits(late_steps=2))
    lab.plant.open()
    for _ in range(2):
        lab.plant.observe()
        wait(lab, 0.3)
        lab.plant.send(Steer(0.5))
    lab.plant.observe()
    wait(lab, 0.3)
    with pytest.raises(AbortError, match="2 control steps in a row were late"):
        lab.plant.send(Steer(0.5))


@pytest.mark.parametrize("call", ["send", "stop"])
def test_a_stop_has_the_time_at_which_it_was_first_sent_and_is_reported_once(call):
    lab = driving()
    lab.plant.events()
    stop = lab.plant.send(Stop()) if call == "send" else lab.plant.stop()
    stops = [sent.sent_ns for sent in lab.actuator.sent if isinstance(sent.action, Stop)]
    assert len(stops) == STOP_COUNT
    assert (stop.action, stop.sent_ns) == (Stop(), stops[0])
    others = [event.sent_ns for event in lab.plant.events() if isinstance(event, Command)]
    assert [sent_ns for sent_ns in others if sent_ns >= stops[0]] == stops[1:]


def test_cells_are_not_waited_for_after_a_stop():
    lab = stopped(**CELLS)
    before = lab.clock.now()
    verdict = lab.plant.settle()
    assert lab.clock.now() == before
    assert verdict.not_at_rest == ""
    assert any(lab.world.moving)


@pytest.mark.parametrize("metres", [0.001, 1.0])
def test_robots_that_do_not_stand_after_a_stop_are_named(metres):
    slow = SETUP.speed * 0.001 / metres
    lab = stopped(setup=replace(SETUP, metres=metres, speed=slow))
    lab.world.deaf = {0}
    lab.world.moving = (True, False, False)
    verdict = lab.plant.settle()
    assert "s after the stop: green still moves (180 mm/s, " in verdict.not_at_rest
    assert verdict.unrest == "this robot still moves: green: switch it off"
    assert [item.text for item in lab.plant.events() if isinstance(item, Note)] == [
        verdict.not_at_rest
    ]


def test_a_stop_that_was_lost_is_repetition_until_the_robots_stand():
    """The trial does not count: where a robot moves after a stop, its pose may be another's."""
    lab = stopped()
    lab.world.moving = (True, False, False)
    before = len(lab.actuator.sent)
    assert lab.plant.settle().not_at_rest.startswith("after the stop green moves")
    assert lab.world.moving == (False, False, False)
    assert all(sent.direction is None for sent in lab.actuator.sent[before:])


def drive_from(lab, begins_ns):
    """Let another program drive all robots forward from a time on; a latched stop holds them."""
    advance = lab.world.advance

    def driven():
        before_ns = lab.world.then_ns
        advance()
        if begins_ns < lab.clock.now() and not lab.actuator.emergencies:
            lab.world.poses[:, 0] += 0.1 * (lab.clock.now() - before_ns) / 1e6

    lab.world.advance = driven


def test_robots_that_another_program_drives_after_the_stop_are_held():
    """Regression: they stood for a moment, the guard saw them move, and nothing stopped them."""
    lab = stopped()
    drive_from(lab, lab.clock.now() + SECOND // 2)
    verdict = lab.plant.settle()
    assert lab.actuator.emergencies
    assert "the robots obeyed only an emergency stop" in verdict.unrest
    assert verdict.not_at_rest


def test_robots_that_move_before_a_run_are_stopped_and_named():
    lab = fake_lab(SETUP, LabLimits(start_mm=1e6))
    drive_from(lab, 0)
    with pytest.raises(AbortError, match="the robots obeyed only an emergency stop") as refused:
        lab.plant.open()
    assert lab.actuator.emergencies
    assert "does another program drive the robots?" in refused.value.message


def test_robots_that_stand_off_their_starts_get_no_latched_stop():
    lab = fake_lab(SETUP)
    lab.world.poses[1, 0] += 120.0
    with pytest.raises(AbortError, match=r"^blue is 120 mm from its start"):
        lab.plant.open()
    assert not lab.actuator.emergencies


def test_an_emergency_stop_is_sent_as_one_and_ends_every_call():
    lab = driving()
    lab.supervision.emergency.set()
    wait(lab, 0.3)
    assert lab.actuator.emergencies == 10
    with pytest.raises(AbortError, match="emergency stop by the operator"):
        lab.plant.send(Steer(0.0))


@pytest.mark.parametrize(("device", "method"), [("actuator", "send"), ("camera", "frames")])
def test_a_bug_in_a_device_stops_the_robots_and_is_told(device, method):
    """A camera that cannot be read must not keep the stop from being sent."""
    lab = driving()

    def broken(*arguments):
        raise ZeroDivisionError("a bug")

    setattr(getattr(lab, device), method, broken)
    wait(lab, 0.3)
    with pytest.raises(AbortError, match="ZeroDivisionError: a bug"):
        lab.plant.observe()
    assert lab.world.moving == (False,) * 3


class Person:
    """Stands for who places the robots; `shown` is what this person was shown, and after each time
    `act(count)` is called."""

    def __init__(self, act=lambda count: None, shows=1):
        self.shown = []
        self.act = act
        self.shows = shows

    def place(self, lines, questions):
        self.shown.append((tuple(lines), questions))
        self.act(len(self.shown))

    def go(self):
        return len(self.shown) >= self.shows


def test_who_lets_robots_start_is_asked_what_only_a_person_knows():
    lab = fake_lab(SETUP)
    lab.actuator.check = lambda: Health(questions=("does it run 802.15.4 firmware?",))
    lab.supervision.prompt = person = Person()
    lab.plant.open()
    assert person.shown[-1] == ((), ("does it run 802.15.4 firmware?",))
    notes = [item.text for item in lab.plant.events() if isinstance(item, Note)]
    assert "does it run 802.15.4 firmware?" in notes


@pytest.mark.parametrize("metres", [0.001, 1.0])
def test_robots_are_waited_for_while_somebody_places_them(metres):
    lab = fake_lab(replace(SETUP, metres=metres), LabLimits(placing=10.0))
    off = 0.12 / metres
    lab.world.poses[1, 0] += off

    def place(count):
        if count == 3:
            lab.world.poses[1, 0] -= off

    lab.supervision.prompt = person = Person(place, 7)
    info = lab.plant.open()
    assert person.shown[0][0] == ("blue is 120 mm from its start (at most 50 mm are allowed)",)
    assert person.shown[-1][0] == ()
    assert info.facts["camera"] == "fake"
    assert info.facts["latency_ms"] == "5.00"


def test_a_stop_that_an_actuator_never_sends_counts_as_not_delivered():
    """Regression: an actuator whose own code raises has no failure, and the log said that a stop
    had reached every robot although none was sent."""
    lab = driving()

    def fail(emergency=False):
        raise ValueError("a defect of the actuator")

    lab.actuator.stop = fail
    now = lab.clock.now()
    stop = lab.plant.stop()
    assert (stop.sent_ns, stop.delivered) == (now, (False,) * 3)


def test_the_last_frame_is_that_of_the_final_poses_however_late_it_is_asked_for():
    """Regression: a slow computer logged over a second of frames after that of the result."""
    lab = stopped()
    final = lab.plant.settle().final.array()
    lab.world.poses[:, 0] += 40  # carried away
    wait(lab, 2.0)
    assert (lab.plant.samples()[-1].observation.poses.array() == final).all()


def test_a_pose_that_turns_in_a_pause_aborts():
    """Regression: the rest in a pause was not checked."""
    lab = driving()
    lab.plant.send(Stop())
    held = lab.world.advance

    def spinning():
        held()
        lab.world.poses[1, 2] = lab.clock.now() / SECOND * 0.2

    lab.world.advance = spinning
    wait(lab, 0.7)
    with pytest.raises(AbortError, match=r"in a pause blue still moves \(0 mm/s, \+0\.20 rad/s\)"):
        lab.plant.send(Steer(0.5))


def test_robots_that_swim_on_end_where_they_were_at_the_stop():
    """The frame that was exposed nearest to it counts, not one before and not the newest."""
    lab = driving(halts=False, checks_of=together)
    wait(lab, 0.2)
    lab.plant.stop()
    stopped_ns = lab.plant._stopped_ns
    wait(lab, 0.5)
    final = lab.plant.settle().final
    samples = lab.plant.samples()
    off_ns = [abs(sample.observation.sampled_ns - stopped_ns) for sample in samples]
    nearest = samples[off_ns.index(min(off_ns))].observation
    assert final.xy.tolist() == nearest.poses.xy.tolist()
    assert nearest.poses.xy.tolist() != samples[-1].observation.poses.xy.tolist()
