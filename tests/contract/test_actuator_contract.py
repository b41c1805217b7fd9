"""What every actuator promises, whatever it moves; see `tetractl.core.protocols.Actuator`."""

from contextlib import suppress

import numpy as np
import pytest
from support.devices import ACTUATORS

from tetractl.core.commands import Steer, Turn
from tetractl.core.errors import AbortError
from tetractl.core.poses import Pose


@pytest.fixture(params=ACTUATORS)
def rig(request, tmp_path):
    with ACTUATORS[request.param](tmp_path) as made:
        yield made


def starts(rig):
    return [Pose(*map(float, row)) for row in rig.setup.starts.array()]


def steer(rig, direction=0.5, moving=None):
    moving = moving or (True,) * len(rig.setup.names)
    return rig.actuator.send(Steer(direction), starts(rig), moving, rig.clock.now())


def test_a_transmission_says_what_was_sent(rig):
    count = len(rig.setup.names)
    with rig.actuator as entered:
        assert entered is rig.actuator
        before = rig.clock.now()
        sent = steer(rig)
        assert sent.direction == 0.5
        assert before <= sent.sent_ns <= rig.clock.now()
        assert sent.moving == (True,) * count
        assert sent.speed.shape == sent.turning.shape == (count,)
        np.testing.assert_allclose(sent.speed, rig.setup.speed, rtol=0.1)
        for wheels in (sent.left, sent.right):
            assert wheels is None or wheels.shape == (count,)
        assert all(isinstance(value, float) for value in sent.outputs.values())


def test_robots_turn_towards_the_direction(rig):
    with rig.actuator:
        for direction in (0.0, 1.5, -2.5):
            turning = steer(rig, direction).turning
            rig.clock.sleep_until(rig.clock.now() + rig.actuator.period_ns)
            wished = rig.setup.a * np.sin(direction - rig.setup.starts.heading)
            np.testing.assert_allclose(turning, wished, atol=0.2 * rig.setup.a.max())


def test_robots_move_when_steered_and_halt_when_stopped_if_they_can(rig):
    with rig.actuator:
        steer(rig)
        assert rig.wait(lambda: all(rig.moves()))
        stop = rig.actuator.stop()
        assert stop.direction is None
        if rig.actuator.halts:
            assert stop.moving == (False,) * len(rig.setup.names)
            assert not stop.speed.any()
            assert not stop.turning.any()
            assert rig.wait(lambda: not any(rig.moves()))


def test_robots_that_halt_turn_on_the_spot_and_others_cannot(rig):
    with rig.actuator:
        moving = (True,) * len(rig.setup.names)
        args = Turn(1.5), starts(rig), moving, rig.clock.now()
        if not rig.actuator.halts:
            with pytest.raises(AbortError, match="on the spot"):
                rig.actuator.send(*args)
            return
        sent = rig.actuator.send(*args)
        assert (sent.action, sent.moving) == (Turn(1.5), moving)
        assert np.abs(sent.speed).max() < 0.1 * rig.setup.speed.min()
        wished = rig.setup.a * np.sin(1.5 - rig.setup.starts.heading)
        np.testing.assert_allclose(sent.turning, wished, atol=0.2 * rig.setup.a.max())


def test_one_robot_can_be_held_if_the_actuator_says_so(rig):
    if not rig.actuator.individual:
        pytest.skip("it moves all robots together")
    with rig.actuator:
        sent = steer(rig, moving=(False, *(True,) * (len(rig.setup.names) - 1)))
        assert not sent.moving[0]
        assert sent.speed[0] == sent.turning[0] == 0.0
        assert rig.wait(lambda: all(rig.moves()[1:]))
        assert not rig.moves()[0]


def test_robots_that_are_not_tracked_can_be_steered_past(rig):
    with rig.actuator:
        poses = [None, *starts(rig)[1:]]
        moving = (False, *(True,) * (len(poses) - 1))
        if not rig.actuator.individual:
            moving = (True,) * len(poses)
        sent = rig.actuator.send(Steer(0.5), poses, moving, rig.clock.now())
        assert np.isfinite(sent.speed).all()
        assert np.isfinite(sent.turning).all()


def test_every_robot_has_a_status_and_a_healthy_device_no_problems(rig):
    with rig.actuator:
        statuses = rig.actuator.poll(1.0)
        assert len(statuses) == len(rig.setup.names)
        assert all(status.problems == () for status in statuses)
        health = rig.actuator.check()
        assert health.problems == ()
        assert all(isinstance(value, str) for value in health.facts.values())
        assert not any(rig.moves())


def test_an_emergency_stop_halts_like_a_stop(rig):
    with rig.actuator:
        steer(rig)
        assert rig.wait(lambda: all(rig.moves()))
        assert rig.actuator.stop(emergency=True).direction is None
        if rig.actuator.halts:
            assert rig.wait(lambda: not any(rig.moves()))


def test_a_device_that_goes_away_fails_for_good(rig):
    with rig.actuator:
        assert rig.actuator.failure is None
        rig.unplug()

        def failed():
            if rig.actuator.failure is None:
                with suppress(AbortError):
                    steer(rig)
            return rig.actuator.failure is not None

        assert rig.wait(failed)
        with pytest.raises(AbortError):
            steer(rig)
        with pytest.raises(AbortError):
            rig.actuator.stop()


def test_the_period_is_positive_and_leaving_is_idempotent(rig):
    with rig.actuator:
        assert rig.actuator.period_ns > 0
    rig.actuator.__exit__(None, None, None)


def test_leaving_needs_no_entering(rig):
    rig.actuator.__exit__(None, None, None)
    rig.actuator.__exit__(None, None, None)
