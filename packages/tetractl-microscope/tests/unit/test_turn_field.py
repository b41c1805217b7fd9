"""Tests of rotating the field, with which cells are found that can be steered."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit.labs import fake_lab
from testkit.paths import EXAMPLES
from tetractl_microscope.choice.candidate import RobotCandidate
from tetractl_microscope.choice.section import require_choice
from tetractl_microscope.choice.turn_field import JITTER, create_rotating_field, turn_field
from tetractl_microscope.handedness import watch_turning

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.errors import AbortError
from tetractl.core.poses import Pose
from tetractl.lab.guard_checks import robot_checks
from tetractl.spec.load import load_spec
from tetractl.spec.plants import select_plant

SPEC = load_spec(EXAMPLES / "tetrahymena_dish.yaml", ("robots.seconds=4",))
EXPERIMENT = select_plant(SPEC, "lab").experiment
CHOICE = require_choice(EXPERIMENT)
BEGIN_S = 48.0
"""Time of the lab's clock when the field begins to turn."""


@given(st.floats(0.5, 20.0), st.integers(0, 2**31))
def test_the_field_turns_once_in_its_time_in_four_steps_of_unequal_angles(turn_s, seed):
    direction = create_rotating_field(turn_s, seed)
    middles_s = (np.arange(40) + 0.5) * turn_s / 4
    angles = np.array([direction(round(s * SECOND)) for s in middles_s])
    assert np.abs(angles).max() <= math.pi
    steps = np.diff(np.unwrap(angles))
    assert np.abs(steps - math.pi / 2).max() <= 2 * JITTER  # always in the same sense
    turned = np.unwrap(angles) - angles[0]
    assert np.abs(turned - math.pi / 2 * np.arange(40)).max() <= 2 * JITTER
    assert np.std(steps) > 0.1
    for share in (-0.45, 0.45):  # it is constant in a step
        beside = [direction(round((s + share * turn_s / 4) * SECOND)) for s in middles_s]
        assert beside == angles.tolist()


def test_each_seed_begins_in_another_direction():
    begins = [create_rotating_field(3.2, seed)(0) for seed in range(50)]
    assert np.ptp(begins) > 5.0
    assert create_rotating_field(3.2, 7)(5 * SECOND) == create_rotating_field(3.2, 7)(5 * SECOND)


def together(rules):
    return replace(robot_checks(rules), together=True)


def cell(number, a=4.0, free=True, x=1500.0):
    return RobotCandidate(number, Pose(x, 1500.0, 0.0), a, 0.1, 400.0, 4.0, free)


CELLS = [cell(1, 3.0), cell(2, 4.0), cell(3, 5.0)]


@pytest.fixture
def dish():
    """A fake lab of swimmers whose camera always sees the same cells."""
    lab = fake_lab(EXPERIMENT.setup, halts=False, checks_of=together)
    VirtualClock.sleep_until(lab.clock, round(BEGIN_S * SECOND))
    lab.camera.robots = ()
    lab.camera.divided = ()
    lab.camera.candidates = lambda: list(CELLS)
    lab.camera.settle = lambda setup, numbers: None
    lab.camera.replace = lambda robot, number: None
    return lab


def turned(dish, on_look=lambda: None, seed=5, choice=CHOICE):
    with dish.plant.rig as rig:
        try:
            return turn_field(rig, choice, seed, dish.supervision, on_look)
        finally:
            rig.loop.stop()


def test_cells_are_returned_after_the_time_of_the_spec_and_the_field_turns_all_the_while(dish):
    looked_ns = []

    def look():
        looked_ns.append(dish.clock.now())

    assert turned(dish, look) == CELLS
    lasted_s = (looked_ns[-1] - looked_ns[0]) / SECOND
    assert lasted_s == pytest.approx(4.0, abs=0.15)
    assert np.diff(looked_ns).max() < 0.1 * SECOND
    directions = [sent.direction for sent in dish.actuator.sent if sent.direction is not None]
    assert len(set(directions)) == 5  # a whole turn of 3.2 s, and a step
    field = create_rotating_field(CHOICE.turn, 5)
    assert set(directions) <= {field(round(k * 0.8 * SECOND) + 1) for k in range(80)}


def test_a_cell_that_was_ever_near_the_edge_is_not_free(dish):
    def candidates():
        at_the_edge = BEGIN_S + 0.5 < dish.clock.now() / SECOND < BEGIN_S + 1
        return [CELLS[0], replace(CELLS[1], free=not at_the_edge), replace(CELLS[2], free=False)]

    dish.camera.candidates = candidates
    short = CHOICE.model_copy(update={"seconds": 1.5})
    assert [found.free for found in turned(dish, choice=short)] == [True, False, False]


def test_a_camera_that_falls_silent_ends_the_turning_after_a_second(dish):
    def fall_silent():
        dish.camera.silent = dish.clock.now() / SECOND > BEGIN_S + 1

    dish.clock.steps.append(fall_silent)
    with pytest.raises(AbortError):
        turned(dish)
    assert 2.0 <= dish.clock.now() / SECOND - BEGIN_S < 2.3


def test_the_failure_of_the_coils_ends_the_turning_in_its_words(dish):
    def fail():
        if dish.clock.now() / SECOND > BEGIN_S + 1:
            dish.actuator.failure = "the supply is off"

    dish.clock.steps.append(fail)
    with pytest.raises(AbortError, match="the supply is off"):
        turned(dish)
    assert 1.0 <= dish.clock.now() / SECOND - BEGIN_S < 1.3


@pytest.mark.parametrize(
    ("lame", "speed", "refused"),
    [
        (False, 420.0, False),
        (True, 420.0, False),  # the camera is quick enough: the cells are the cause
        (True, 6000.0, True),
        (False, 6000.0, False),  # enough cells respond all the same
    ],
)
def test_a_slow_search_is_named_if_too_few_cells_respond(dish, lame, speed, refused):
    cells = [replace(found, a_sd=9.0) for found in CELLS] if lame else CELLS
    dish.camera.candidates = lambda: list(cells)
    choice = CHOICE.model_copy(update={"speed": speed, "seconds": 1.0})
    with dish.plant.rig as rig:
        try:
            if not refused:
                assert turn_field(rig, choice, 1, dish.supervision) == cells
                return
            with pytest.raises(AbortError, match=r"only 120\.0 images per second .* but 171 are"):
                turn_field(rig, choice, 1, dish.supervision)
        finally:
            rig.loop.stop()


def swimming(dish, mirrored=False, walled=()):
    """Let cells swim in the field that is sent, with turning rates of 3 to 5 rad/s."""
    headings = {number: float(number) for number in range(1, 6)}
    places = dict.fromkeys(headings, 1500.0 + 1500.0j)
    last_s = [BEGIN_S]

    def candidates():
        now_s = dish.clock.now() / SECOND
        sent = [s.direction for s in dish.actuator.sent if s.direction is not None]
        for number in headings if sent else ():
            off = math.sin(sent[-1] - headings[number])
            headings[number] += (2.5 + 0.5 * number) * off * (now_s - last_s[0])
            places[number] += 400 * np.exp(1j * headings[number]) * (now_s - last_s[0])
        last_s[0] = now_s
        return [
            RobotCandidate(
                number,
                Pose(place.real, -place.imag if mirrored else place.imag, headings[number]),
                *(4.0, 0.1, 400.0, 4.0),
                free=number not in walled,
            )
            for number, place in places.items()
        ]

    dish.camera.candidates = candidates


@pytest.mark.parametrize("mirrored", [False, True])
def test_watching_the_turning_shows_a_mirrored_image(dish, mirrored):
    swimming(dish, mirrored)
    with dish.plant.rig as rig:
        cells, turning = watch_turning(rig, CHOICE, 3, dish.supervision)
    assert [found.number for found in cells] == [1, 2, 3, 4, 5]
    assert turning.cells == 5
    assert turning.mirrored is mirrored
    assert turning.explained > 0.8
    assert abs(turning.turned) < 0.3 or mirrored


@pytest.mark.parametrize(("walled", "counted"), [((2, 4), 3), ((1, 2, 4), None)])
def test_cells_near_the_edge_say_nothing_of_the_image(dish, walled, counted):
    swimming(dish, walled=walled)
    with dish.plant.rig as rig:
        _, turning = watch_turning(rig, CHOICE, 3, dish.supervision)
    assert (turning and turning.cells) == counted
