"""Tests of what every plant must do; see `tetractl.core.protocols.Plant`."""

import itertools
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import pytest
from testkit.plants import RIGS

from tetractl.core.clock import SECOND
from tetractl.core.commands import FieldOff, Steer, Stop, Turn
from tetractl.core.errors import AbortError
from tetractl.core.poses import wrap
from tetractl.core.trial import Verdict

pytestmark = pytest.mark.slow

PERIOD = SECOND // 5


# One plant for each kind of promise is enough for every change.
OFTEN = ("lab", "sim, undisturbed", "sim, everything", "sim, wheels, radio", "sim, dish")


@pytest.fixture(
    params=[
        pytest.param(name, marks=() if name.startswith(OFTEN) else pytest.mark.system)
        for name in RIGS
    ]
)
def make(request):
    return RIGS[request.param]


@contextmanager
def opened(rig):
    """A plant as the trial loop uses it: stopped, settled and closed whatever happens."""
    info = rig.plant.open()
    try:
        yield info
    finally:
        rig.plant.stop()
        rig.plant.settle()
        rig.plant.close()


@dataclass(frozen=True)
class Driven:
    """All that came out of a plant that was driven and stopped, in order."""

    observations: list
    commands: list
    samples: list
    verdict: Verdict


def drive(rig, directions, period=PERIOD):
    """Open, steer, stop, settle, close; everything that came out."""
    observations = []
    commands = []
    samples = []
    rig.plant.open()
    began = rig.clock.now()
    for k, direction in enumerate(directions, start=1):
        observations.append(rig.plant.observe())
        commands.append(rig.plant.send(Steer(direction)))
        samples += rig.plant.samples()
        rig.clock.sleep_until(began + k * period)
    commands.append(rig.plant.stop())
    verdict = rig.plant.settle()
    samples += rig.plant.samples()
    rig.plant.close()
    return Driven(observations, commands, samples, verdict)


def wait(rig, duration_ns):
    rig.clock.sleep_until(rig.clock.now() + duration_ns)


def starts_of(rig):
    return np.array([robot.start for robot in rig.spec.robots])


def ways(before, after):
    """How far each robot is from where it was."""
    return np.hypot(*(after.xy - before.xy).T)


DIRECTIONS = (0.5, -2.0, 3.1, 0.0, -1.0)


def test_open_tells_what_the_plant_is(make):
    rig = make(1)
    with opened(rig) as info:
        assert info.kind == rig.kind
        assert info.camera_rate_hz == pytest.approx(rig.camera_rate_hz, rel=1e-5)
        assert all(isinstance(value, str) for value in info.facts.values())


def test_the_first_frame_is_there_when_open_returns(make):
    rig = make(1)
    with opened(rig):
        observation = rig.plant.observe()
        poses = observation.poses
        for column in (poses.x, poses.y, poses.heading, observation.valid):
            assert column.shape == (len(rig.spec.robots),)
        assert np.abs(observation.poses.xy - starts_of(rig)).max() <= rig.true_to


def test_an_observation_is_never_of_the_future_and_never_goes_back(make):
    rig = make(1)
    with opened(rig):
        began = rig.clock.now()
        first = rig.plant.observe().frame
        frame = first
        for k in range(1, 30):
            rig.clock.sleep_until(began + k * SECOND // 37)
            observation = rig.plant.observe()
            assert observation.sampled_ns <= observation.received_ns <= rig.clock.now()
            assert observation.frame >= frame
            frame = observation.frame
        assert frame > first


def test_samples_come_once_each_in_order_at_camera_rate(make):
    rig = make(1)
    samples = drive(rig, DIRECTIONS).samples
    frames = [sample.observation.frame for sample in samples]
    assert frames == list(range(frames[0], frames[0] + len(frames)))
    times = np.array([sample.observation.sampled_ns for sample in samples])
    gaps = np.diff(times) * rig.camera_rate_hz / SECOND
    assert gaps == pytest.approx(1.0, abs=1e-6)
    assert rig.plant.samples() == []


def test_commands_say_what_was_sent(make):
    rig = make(1)
    commands = drive(rig, DIRECTIONS).commands
    assert [command.direction for command in commands] == [*DIRECTIONS, None]
    assert [command.sent_ns for command in commands] == sorted(c.sent_ns for c in commands)
    for command in commands:
        assert len(command.delivered) == len(rig.spec.robots)
        if rig.spec.wheels:
            assert command.left.shape == command.right.shape == (len(rig.spec.robots),)
    if rig.spec.wheels:
        assert np.all(commands[-1].left == 0)
        assert np.all(commands[-1].right == 0)


def test_robots_go_straight_on_with_the_field_off_where_it_can_be_switched(make):
    rig = make(1)
    with opened(rig):
        rig.plant.send(Steer(1.0))
        if rig.kind == "lab":
            with pytest.raises(AbortError):
                rig.plant.send(FieldOff())
            return
        wait(rig, PERIOD)
        sent = rig.plant.send(FieldOff())
        assert (sent.action, sent.stops) == (FieldOff(), False)
        if rig.spec.wheels and "drive" not in rig.spec.plant.model_fields_set:
            assert sent.left.tolist() == sent.right.tolist() == rig.spec.setup.speed.tolist()
        wait(rig, PERIOD)  # any dead time has passed
        rig.plant.observe()
        before = rig.plant.poses.array()
        wait(rig, PERIOD)
        rig.plant.observe()
        after = rig.plant.poses.array()
        moved = after - before
        assert np.hypot(*moved[:, :2].T).min() > 10
        if not rig.disturbed and "drive" not in rig.spec.plant.model_fields_set:
            assert after[:, 2] == pytest.approx(before[:, 2], abs=1e-12)
            assert np.arctan2(moved[:, 1], moved[:, 0]) == pytest.approx(after[:, 2], abs=1e-9)


def test_stop_is_idempotent(make):
    rig = make(1)
    rig.plant.open()
    rig.plant.send(Steer(1.0))
    wait(rig, PERIOD)
    first = rig.plant.stop()
    wait(rig, PERIOD)
    second = rig.plant.stop()
    assert first.direction is None
    assert (second.direction, second.sent_ns) == (None, first.sent_ns)
    rig.plant.settle()
    rig.plant.stop()
    rig.plant.close()
    rig.plant.stop()


def test_robots_stand_in_a_pause_and_drive_on_with_the_next_direction(make):
    rig = make(1)

    def steer():
        for _ in range(6):
            assert not rig.plant.send(Steer(1.5)).stops  # clear of obstacles
            wait(rig, PERIOD)

    def ways_in_a_period():
        before = rig.plant.observe().poses
        wait(rig, PERIOD)
        return ways(before, rig.plant.observe().poses)

    with opened(rig):
        steer()
        assert ways_in_a_period().min() > 5
        assert rig.plant.send(Stop()).stops
        wait(rig, SECOND // 2)
        assert ways_in_a_period().max() <= 2 * rig.true_to + 1e-6
        steer()
        assert ways_in_a_period().min() > 5


def test_robots_on_wheels_turn_on_the_spot_in_a_pause(make):
    rig = make(1)
    if not rig.plant.setup.on_wheels:
        pytest.skip("these robots cannot turn on the spot")
    with opened(rig):
        rig.plant.send(Steer(0.7))
        wait(rig, PERIOD)
        rig.plant.send(Stop())
        wait(rig, SECOND // 2)
        before = rig.plant.observe().poses
        facing = float(before.heading[0]) + 1.0
        for _ in range(4):
            turned = rig.plant.send(Turn(facing))
            assert turned.stops
            assert turned.action == Turn(facing)
            wait(rig, PERIOD)
        rig.plant.send(Stop())
        wait(rig, SECOND // 2)
        after = rig.plant.observe().poses
        assert before.distances(after.xy).max() < 25 + 2 * rig.true_to  # a flow carries some
        off = np.abs([wrap(facing - poses.heading) for poses in (before, after)])
        assert (off[1] < off[0]).all()
        assert off[1, 0] < 0.5


def test_a_plant_in_virtual_time_repeats_itself_by_seed(make):
    def run(seed):
        rig = make(seed)
        driven = drive(rig, DIRECTIONS)
        poses = [sample.observation.poses for sample in driven.samples]
        truths = [sample.truth for sample in driven.samples if sample.truth]
        numbers = [p.array() for p in (*poses, *truths, driven.verdict.final)]
        delivered = [command.delivered for command in driven.commands]
        return np.concatenate(numbers).tobytes(), delivered

    assert run(1) == run(1)
    assert (run(1) != run(2)) == make(1).disturbed


def test_how_often_a_plant_is_looked_at_does_not_change_it(make):
    """Disturbances come from the seed, not from the calls."""
    finals = []
    for looks in (1, 17):
        rig = make(3)
        rig.plant.open()
        began = rig.clock.now()
        for k, look in itertools.product(range(4), range(looks)):
            if look == 0:
                rig.plant.send(Steer(DIRECTIONS[k]))
            rig.clock.sleep_until(began + k * PERIOD + (look + 1) * PERIOD // looks)
            rig.plant.observe()
            rig.plant.samples()
        rig.plant.stop()
        finals.append(rig.plant.settle().final.array())
    assert finals[1] == pytest.approx(finals[0], abs=1e-8)
