"""Tests of the rules of the guard: they are the spec's, in its unit of length."""

from dataclasses import replace

import pytest
from testkit.trials import experiment

from tetractl.core.clock import SECOND
from tetractl.core.poses import Sight
from tetractl.lab.guard_rules import NOISE_MM, SILENCE_MIN_S, GuardRules
from tetractl.spec.lab_section import LabLimits

SETUP = experiment(wheels={"radius": 40}).setup


def rules(setup=SETUP, **limits):
    return GuardRules.from_setup(setup, LabLimits(**limits))


def test_robots_and_arena_are_those_of_the_spec():
    made = rules()
    assert made.names == ("green", "blue", "red")
    assert made.speeds == (180, 200, 150)
    assert made.turning == (6, 4, 3)
    assert (made.arena, made.wheel_radius, made.sight) == (SETUP.arena, 40, SETUP.sight)
    assert rules(experiment().setup).wheel_radius == 0


@pytest.mark.parametrize(("metres", "mm"), [(0.001, 1.0), (1.0, 1000.0), (1e-6, 0.001)])
def test_a_length_unit_has_so_many_millimetres(metres, mm):
    made = rules(replace(SETUP, metres=metres))
    assert made.mm_per_unit == pytest.approx(mm)
    assert made.position_error_max == pytest.approx(NOISE_MM / mm)


def test_the_largest_error_is_noise_and_what_the_camera_states():
    sight = Sight(grid_mm=3.0, noise_mm=0.5)
    made = replace(rules(), sight=sight, mm_per_unit=2.0)
    assert made.position_error_max == pytest.approx((NOISE_MM + sight.largest_error_mm) / 2)


@pytest.mark.parametrize(
    ("period_s", "late_steps", "silence_s"),
    [(1.0, 2, 3.0), (0.2, 4, 1.0), (0.1, 1, SILENCE_MIN_S), (0.25, 1, 0.5), (0.3, 1, 0.6)],
)
def test_silence_is_so_many_periods_but_never_shorter_than_its_minimum(
    period_s, late_steps, silence_s
):
    made = rules(replace(SETUP, period_s=period_s), late_steps=late_steps)
    assert made.silence_ns == round(silence_s * SECOND)


def test_obstacles_are_grown_by_the_radius_of_a_body():
    for radius in (0.0, 25.0):
        grown = rules(replace(SETUP, body_radius=radius)).obstacles
        assert [shape.radius for shape in grown] == [
            shape.radius + radius for shape in SETUP.obstacles
        ]


def test_a_run_goes_on_without_a_robot_only_if_the_spec_says_so():
    keep = experiment(on_loss={"type": "keep-going"}).setup if False else SETUP
    assert rules(replace(keep, loss=None)).may_lose_robots is False

    class Loss:
        def __init__(self, ends_trial):
            self.ends_trial = ends_trial

    assert rules(replace(keep, loss=Loss(ends_trial=True))).may_lose_robots is False
    assert rules(replace(keep, loss=Loss(ends_trial=False))).may_lose_robots is True
