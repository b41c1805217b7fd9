"""Tests that the field is stopped before the camera is closed, however the survey ends.

Closing the camera may take long.
"""

from dataclasses import replace

import numpy as np
import pytest
from testkit.labs import FakeCamera, fake_lab
from testkit.paths import EXAMPLES
from tetractl_microscope.choice.prepare import prepare
from tetractl_microscope.choice.section import require_choice
from tetractl_microscope.handedness import watch_turning

from tetractl.core.clock import SECOND
from tetractl.core.errors import AbortError
from tetractl.lab.guard_checks import robot_checks
from tetractl.plant.lab_plant import RigSection
from tetractl.spec.lab_section import STOP_COUNT
from tetractl.spec.load import load_spec
from tetractl.spec.plants import select_plant

SPEC = load_spec(EXAMPLES / "tetrahymena_dish.yaml", ("robots.seconds=4",))
EXPERIMENT = select_plant(SPEC, "lab").experiment


def together(rules):
    return replace(robot_checks(rules), together=True)


@pytest.fixture
def dish(monkeypatch):
    """A fake lab of swimmers, whose camera sees no cell that it could follow."""
    lab = fake_lab(EXPERIMENT.setup, halts=False, checks_of=together)
    lab.camera.robots = ()
    lab.camera.divided = ()
    lab.camera.candidates = list
    lab.camera.settle = lambda setup, numbers: None
    lab.camera.replace = lambda robot, number: None
    monkeypatch.setattr(RigSection, "rig", lambda *_, **__: lab.plant.rig)
    return lab


@pytest.fixture
def stops_before(dish, monkeypatch):
    """The numbers of stops in a row that were the last sent when the camera was closed."""
    numbers = []
    leave = FakeCamera.__exit__

    def note_stops(camera, *error):
        directions = [sent.direction for sent in dish.actuator.sent]
        steered = [k for k, direction in enumerate(directions) if direction is not None]
        numbers.append(len(directions) - 1 - steered[-1])
        leave(camera, *error)

    monkeypatch.setattr(FakeCamera, "__exit__", note_stops)
    return numbers


def cancel(dish):
    """Let the operator cancel after a second."""
    dish.supervision.cancelled = lambda: dish.clock.now() > SECOND


def press_the_key(dish):
    """Let the operator press the key of the emergency stop after a second."""

    def press():
        if dish.clock.now() > SECOND:
            dish.supervision.emergency.set()

    dish.clock.steps.append(press)


def prepare_a_trial(dish):
    """Turn the field to choose the robots of a trial."""
    prepare(EXPERIMENT, dish.clock, np.random.SeedSequence(1), dish.supervision)


def survey(dish):
    """Turn the field to see how cells turn with it, as `lab survey` does."""
    with dish.plant.rig as rig:
        watch_turning(rig, require_choice(EXPERIMENT), 1, dish.supervision)


ENDS = [(cancel, KeyboardInterrupt), (press_the_key, AbortError)]


@pytest.mark.parametrize("turn", [prepare_a_trial, survey])
@pytest.mark.parametrize(("end", "error"), ENDS)
def test_a_field_that_turns_is_stopped_before_the_camera_is_closed(
    end, error, turn, dish, stops_before
):
    """Regression: the camera was closed first, while the driver held the last direction; then one
    stop was sent, or none by an actuator that does not stop when it is closed."""
    end(dish)
    with pytest.raises(error):
        turn(dish)
    assert stops_before[0] >= STOP_COUNT


def test_an_emergency_stop_while_the_field_turns_is_sent_ten_times(dish):
    """Regression: the loop was closed after the first to third of them."""
    press_the_key(dish)
    with pytest.raises(AbortError, match="emergency stop by the operator"):
        survey(dish)
    assert dish.actuator.emergencies >= STOP_COUNT


def test_a_field_is_stopped_if_no_cell_can_be_chosen(dish, stops_before):
    """Regression: it turned on until camera and loop were closed."""
    with pytest.raises(AbortError, match="0 of 0 cells respond to the field"):
        prepare_a_trial(dish)
    assert stops_before == [STOP_COUNT]
