"""Defaults of the recommended controller that follow from the spec, and its prior's units."""

from dataclasses import replace

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from tetractl.core.poses import Sight
from tetractl.spec.load import parse_contents

ROBOTS = [
    {"name": "one", "start": [300, 300], "target": [700, 600], "a": 6, "speed": 180},
    {"name": "two", "start": [300, 700], "target": [700, 200], "a": 3, "speed": 120},
]


def loaded(controller=None, **fields):
    contents = {
        "name": "two",
        "arena": {"left": 0, "bottom": 0, "width": 1000, "height": 900},
        "robots": ROBOTS,
        "controller": {"type": "mpc"} | (controller or {}),
    }
    return parse_contents(yaml.safe_load(yaml.safe_dump(contents | fields)), "two.yaml").experiment


def controller_of(**controller):
    return loaded(controller).controller


@given(st.integers(20, 1000))
def test_a_signal_lasts_about_a_fifth_of_a_second(period_ms):
    """Always a whole number of periods, and at least one."""
    made = controller_of(period=period_ms / 1000)
    assert made.signal_periods >= 1
    lasts_ms = made.signal_periods * period_ms
    assert abs(lasts_ms - 200) <= period_ms / 2 or made.signal_periods == 1
    assert made.deadline == pytest.approx(0.8 * period_ms / 1000)


def test_what_a_spec_states_replaces_the_default():
    made = controller_of(period=0.05, signal_periods=3, deadline=0.02, accept_error=7)
    assert (made.signal_periods, made.deadline, made.accept_error) == (3, 0.02, 7)


@given(st.integers(20, 400))
def test_the_error_that_is_accepted_is_about_half_the_path_of_a_period(period_ms):
    """0.45 of it, in two digits."""
    path = period_ms / 1000 * (180 + 120)
    accepted = controller_of(period=period_ms / 1000).accept_error
    assert accepted == pytest.approx(0.45 * path, rel=0.05)
    assert accepted == float(f"{accepted:.2g}")


def test_a_plan_has_a_signal_for_each_of_its_periods():
    experiment = loaded({"period": 0.05, "signal_periods": 3})
    problem = experiment.controller.problem(experiment.setup)
    assert problem.period == problem.first_period == pytest.approx(0.15)
    assert problem.swept


def test_only_robots_on_wheels_may_pause():
    cells = loaded()
    assert not cells.setup.on_wheels
    assert not cells.controller.collision.stop_before_collision


def test_without_identification_the_values_of_the_spec_are_certain():
    experiment = loaded({"estimate": False})
    prior = experiment.controller.known(experiment.setup)
    assert prior.a.tolist() == [6, 3]
    assert prior.speed.tolist() == [180, 120]
    assert prior.a_std == prior.speed_std == prior.dead_time_std == 0


def test_the_prior_has_the_lengths_of_the_spec_in_its_unit():
    """The same cells in um and in mm: lengths differ by 1000, all else is alike."""
    in_mm = [
        robot | {"start": [v / 1000 for v in robot["start"]], "speed": robot["speed"] / 1000,
                 "target": [v / 1000 for v in robot["target"]]}
        for robot in ROBOTS
    ]  # fmt: skip
    small = {"left": 0, "bottom": 0, "width": 1.0, "height": 0.9}
    um = loaded(units={"length": "um"})
    mm = loaded(units={"length": "mm"}, robots=in_mm, arena=small)
    first, second = (e.controller.known(e.setup) for e in (um, mm))
    assert first.a.tolist() == second.a.tolist()
    assert first.speed == pytest.approx(1000 * second.speed)
    assert first.flow_std == pytest.approx(1000 * second.flow_std)
    assert first.flow_std == pytest.approx(0.05 * 150)
    assert first.helix_radius == pytest.approx(1000 * second.helix_radius)
    assert first.helix_radius > 0
    assert first.pose_std[:2] == pytest.approx([1000 * v for v in second.pose_std[:2]])
    assert first.pose_std[2] == second.pose_std[2]
    assert first.helix_frequency == second.helix_frequency
    assert first.side_std == 0


@pytest.mark.parametrize(("unit", "in_unit"), [("mm", 1), ("um", 1000), ("cm", 0.1)])
def test_the_precision_of_a_camera_is_in_the_unit_of_the_spec(unit, in_unit):
    experiment = loaded(units={"length": unit})
    sight = Sight(grid_mm=4.0, grid_rad=0.1, noise_mm=2.0, noise_rad=0.05)
    x, y, heading = experiment.controller.known(replace(experiment.setup, sight=sight)).pose_std
    x_mm, y_mm, heading_rad = sight.pose_std
    assert x_mm > 0
    assert (x, y) == pytest.approx((x_mm * in_unit, y_mm * in_unit))
    assert heading == heading_rad


def test_cells_that_may_rest_are_attempted_for_at_most_half_the_time():
    setup = loaded().setup
    noise = {"position_noise": 1.0, "heading_noise": 0.05}
    for limit_s in (20, 100, 100_000):
        known = loaded({"time_limit": limit_s, "prior": noise}).controller
        usual = loaded({"time_limit": limit_s, "prior": {"position_noise": 0}}).controller
        assert known.prior.rests(setup)
        assert not usual.prior.rests(setup)
        assert known.patience_s(setup) == min(usual.patience_s(setup), limit_s / 2)
