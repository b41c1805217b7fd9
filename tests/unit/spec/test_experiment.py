"""Tests of the experiment: its fields, what they refuse, and the setup that follows from them."""

import json
import math
from copy import deepcopy

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit.marked_robots import install
from testkit.paths import ROOT

from tetractl.core.registries import CONTROLLERS, TRIAL_ROBOTS
from tetractl.core.registry import Kind
from tetractl.spec.experiment import (
    Experiment,
    PerStrength,
    assign_targets,
    find_packages,
    strength_unit,
    turning_rate,
)
from tetractl.spec.load import load_spec, parse_contents
from tetractl.spec.plants import select_plant
from tetractl.spec.yaml.problems import InvalidSpecError

CONTENTS = {
    "name": "s",
    "arena": {"left": -20, "bottom": 10, "width": 100, "height": 60},
    "robots": [
        {"name": "one", "start": [0, 20], "target": [60, 25], "a": 3, "speed": 20},
        {"name": "two", "start": [0, 40], "target": [61, 45], "a": 4, "speed": 30},
    ],
}
WHEELS = {"wheels": {"radius": 5, "lag": 0.15}}


def contents(robots=(), **changes):
    """The contents of the spec above, with other fields, and with changes of its robots."""
    changed = deepcopy(CONTENTS) | changes
    for robot, change in zip(changed["robots"], robots, strict=False):
        robot.update(change)
    return changed


def made(robots=(), **changes):
    return parse_contents(contents(robots, **changes), "s.yaml").experiment


def problem_of(spec):
    """The field and the message of the only problem of a spec."""
    with pytest.raises(InvalidSpecError) as caught:
        parse_contents(spec, "s.yaml")
    (problem,) = caught.value.problems
    return problem.field, problem.message


# arena and setup


def test_the_arena_reaches_from_its_lower_left_corner_by_its_size():
    bounds = made().arena.bounds
    assert (bounds.left, bounds.bottom, bounds.right, bounds.top) == (-20, 10, 80, 70)
    assert made().setup.arena == bounds


def test_the_setup_holds_the_numbers_of_each_robot_in_order():
    heading = [{"heading": 0.5, "color": "red"}, {"heading": -1.0}]
    setup = made(heading, units={"length": "cm"}).setup
    assert setup.name == "s"
    assert (setup.unit, setup.metres) == ("cm", 0.01)
    assert setup.names == ("one", "two")
    assert setup.colors == ("red", None)
    assert setup.starts.xy.tolist() == [[0, 20], [0, 40]]
    assert setup.starts.heading.tolist() == [0.5, -1.0]
    assert setup.targets.tolist() == [[60, 25], [61, 45]]
    assert setup.a.tolist() == [3, 4]
    assert setup.speed.tolist() == [20, 30]
    assert setup.obstacles == ()
    assert setup.way_points.shape == (0, 2, 2)


@pytest.mark.parametrize(("unit", "metres"), [("um", 1e-6), ("mm", 1e-3), ("cm", 1e-2), ("m", 1)])
def test_a_length_unit_has_its_length_in_metres(unit, metres):
    assert made(units={"length": unit}).setup.metres == metres


def test_way_points_are_grouped_by_leg_and_then_by_robot():
    vias = [{"via": [[1, 21], [2, 22]]}, {"via": [[3, 43], [4, 44]]}]
    way_points = made(vias).setup.way_points
    assert way_points.tolist() == [[[1, 21], [3, 43]], [[2, 22], [4, 44]]]


def test_the_controllers_times_are_those_of_the_setup():
    controller = {"type": "mpc", "period": 0.1, "time_limit": 33, "collision": {"radius": 4}}
    setup = made(controller=controller).setup
    assert (setup.period_s, setup.time_limit_s, setup.body_radius) == (0.1, 33, 4)


def test_robots_without_wheels_never_stop_by_themselves_and_have_no_lag():
    setup = made().setup
    assert setup.wheel_radius is None
    assert setup.watchdog_s == math.inf
    assert setup.lag_s == 0


def test_wheels_give_their_radius_watchdog_and_lag():
    setup = made(wheels={"radius": 5, "watchdog": 0.25, "lag": 0.15}).setup
    assert (setup.wheel_radius, setup.watchdog_s, setup.lag_s) == (5, 0.25, 0.15)
    assert made(**WHEELS).setup.watchdog_s == math.inf


LAB_SPEC = ROOT / "experiments/three_m3pi_lab.yaml"


def in_lab(*settings):
    return select_plant(load_spec(LAB_SPEC, settings), "lab").experiment


def test_the_lag_of_a_lab_replaces_that_of_the_wheels_only_in_the_lab():
    settings = ["wheels.lag=0.2", "lab.lag=0.3"]
    assert load_spec(LAB_SPEC, settings).experiment.setup.lag_s == 0.2
    assert in_lab(*settings).setup.lag_s == 0.3
    assert in_lab("wheels.lag=0.2", "lab.lag=null").setup.lag_s == 0.2
    assert in_lab("wheels.lag=0.2", "lab.lag=0").setup.lag_s == 0


def test_a_copy_with_other_robots_has_their_setup():
    experiment = made()
    before = experiment.setup
    slow = experiment.robots[0].model_copy(update={"speed": 7.0})
    copied = experiment.model_copy(update={"robots": (slow, experiment.robots[1])})
    assert copied.setup.speed.tolist() == [7, 30]
    assert experiment.setup is before


def test_a_hold_is_the_task_of_the_setup():
    hold = made(hold={"radius": 5, "time": 10}).setup.hold
    assert (hold.radius, hold.seconds) == (5, 10)
    assert made().setup.hold is None


# what happens to lost robots


def test_a_simulation_without_wheels_has_no_rule_for_lost_robots_unless_it_goes_on():
    assert made().setup.loss is None
    rule = made(on_lost="drop").setup.loss
    assert (rule.after_s, rule.replaces_lost, rule.includes_dead, rule.ends_trial) == (
        0.3,
        False,
        False,
        False,
    )


def test_a_robot_on_wheels_that_stands_counts_as_lost():
    rule = made(**WHEELS).setup.loss
    assert (rule.replaces_lost, rule.includes_dead, rule.ends_trial) == (False, True, True)
    assert made(**WHEELS, on_lost="drop").setup.loss.ends_trial is False


def test_the_time_of_a_lost_robot_is_the_limit_of_the_lab():
    assert in_lab("lab.limits.untracked_abort=0.7").setup.loss.after_s == 0.7
    assert in_lab().setup.loss.after_s == 0.3


MARKS = {"marks": [[0, 20], [0, 40]]}


@pytest.fixture
def marks(monkeypatch):
    """Let trials find their robots on marks."""
    install(monkeypatch)


def with_marks(**changes):
    return contents(**changes) | {"robots": MARKS}


@pytest.mark.usefixtures("marks")
def test_robots_can_be_replaced_only_if_each_trial_chooses_them():
    field, message = problem_of(contents(on_lost="replace"))
    assert field == "on_lost"
    assert "only with 'robots: {choose: N}' and without obstacles" in message
    chosen = parse_contents(with_marks(on_lost="replace"), "s").experiment
    assert chosen.setup.loss.replaces_lost
    box = {"type": "rectangle", "left": 25, "bottom": 25, "width": 9, "height": 9}
    assert problem_of(with_marks(on_lost="replace", obstacles=[box]))[0] == "on_lost"


@pytest.mark.usefixtures("marks")
def test_stand_ins_wait_in_the_middle_of_the_arena_until_a_trial_finds_its_robots():
    experiment = parse_contents(with_marks(), "s").experiment
    assert [robot.start for robot in experiment.robots] == [(30, 40), (30, 40)]
    assert experiment.must_choose_robots
    assert experiment.stated_robots == experiment.chosen
    assert not made().must_choose_robots
    assert made().stated_robots == made().robots


@pytest.mark.usefixtures("marks")
def test_free_targets_are_not_dealt_before_the_robots_are_found():
    assert parse_contents(with_marks(assign="free"), "s").experiment.assign == "free"
    assert made(assign="free").assign == "given"


# targets


@given(st.integers(0, 100_000), st.integers(1, 4), st.integers(0, 2))
def test_dealt_targets_are_all_different_and_no_exchange_is_better(seed, count, more):
    rng = np.random.default_rng(seed)
    starts = rng.uniform(-10, 10, (count, 2))
    targets = rng.uniform(-10, 10, (count + more, 2))
    goals = assign_targets(starts, targets)
    assert len(set(goals)) == count
    total = np.square(starts - targets[goals]).sum()
    for i in range(count):
        for target in range(count + more):
            other = list(goals)
            if target in other:
                k = other.index(target)
                other[i], other[k] = other[k], other[i]
            else:
                other[i] = target
            assert total <= np.square(starts - targets[other]).sum() + 1e-9


def test_free_targets_go_to_the_robots_whose_paths_are_alike():
    crossed = [{"target": [60, 45]}, {"target": [60, 25]}]
    assert [robot.target for robot in made(crossed).robots] == [(60, 45), (60, 25)]
    freed = made(crossed, assign="free")
    assert [robot.target for robot in freed.robots] == [(60, 25), (60, 45)]
    assert [robot.name for robot in freed.robots] == ["one", "two"]
    assert [robot.speed for robot in freed.robots] == [20, 30]
    assert freed.setup.targets.tolist() == [[60, 25], [60, 45]]


# what is refused


def test_all_robots_need_the_same_number_of_way_points():
    field, message = problem_of(contents([{"via": [[9, 20]]}]))
    assert field == "robots"
    assert message.startswith("have 0 and 1 way-points in via")
    made([{"via": [[9, 20]]}, {"via": [[9, 40]]}])


@pytest.mark.parametrize("color", ["red", "green", "teal", "#00ff00", "#00FF00", None])
def test_colours_that_exist_are_accepted(color):
    assert made([{"color": color}]).robots[0].color == color


@pytest.mark.parametrize("color", ["gren", "#00ff0", "Red", "#00ff0g", ""])
def test_colours_that_do_not_exist_are_refused(color):
    assert problem_of(contents([{"color": color}]))[0] == "robots.0.color"


@pytest.mark.parametrize("seed", [0, 1, 2**64 - 1])
def test_a_seed_is_a_whole_number_of_64_bits(seed):
    assert made(trials={"seed": seed}).trials.seed == seed


@pytest.mark.parametrize("seed", [-1, 2**64, 0.5])
def test_other_seeds_are_refused(seed):
    assert problem_of(contents(trials={"seed": seed}))[0] == "trials.seed"


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"trials": {"count": 0}}, "trials.count"),
        ({"trials": {"count": 1_000_001}}, "trials.count"),
        ({"hold": {"radius": 0, "time": 1}}, "hold.radius"),
        ({"hold": {"radius": 1, "time": 0}}, "hold.time"),
        ({"error_bound": 0}, "error_bound"),
        ({"name": ""}, "name"),
        ({"name": "-s"}, "name"),
        ({"name": "s" * 65}, "name"),
        ({"arena": {"left": 0, "bottom": 0, "width": 0, "height": 99}}, "arena.width"),
        ({"arena": {"left": 0, "bottom": 0, "width": 99, "height": -1}}, "arena.height"),
        ({"reference": {"source": "x", "n": 1, "mean": 1, "std": 1}}, "reference.n"),
        ({"reference": {"source": "x", "n": 2, "mean": -1, "std": 1}}, "reference.mean"),
        ({"wheels": {"radius": 0}}, "wheels.radius"),
        ({"wheels": {"radius": 1, "lag": -0.1}}, "wheels.lag"),
        ({"wheels": {"radius": 1, "watchdog": 0}}, "wheels.watchdog"),
        ({"robots": []}, "robots"),
    ],
)
def test_a_value_beyond_its_limit_is_refused_at_its_field(change, field):
    assert problem_of(deepcopy(CONTENTS) | change)[0] == field


@pytest.mark.parametrize(
    "change",
    [
        {"trials": {"count": 1}},
        {"trials": {"count": 1_000_000}},
        {"name": "s" * 64},
        {"name": "3.s-S_x"},
        {"reference": {"source": "x", "n": 2, "mean": 0, "std": 0}},
        {"wheels": {"radius": 1, "lag": 0}},
        {"error_bound": 0.001},
    ],
)
def test_a_value_at_its_limit_is_accepted(change):
    assert parse_contents(deepcopy(CONTENTS) | change, "s").experiment


# turning rates


def test_a_turning_rate_per_strength_is_proportional_to_it():
    magnetic = PerStrength(per_mT=0.5)
    electric = PerStrength(per_V_cm=2.0)
    assert (magnetic.key, magnetic.alpha) == ("per_mT", 0.5)
    assert (electric.key, electric.alpha) == ("per_V_cm", 2.0)
    assert (turning_rate(magnetic, 3.0), turning_rate(electric, 3.0), turning_rate(7.0, 3.0)) == (
        1.5,
        6.0,
        7.0,
    )
    assert (turning_rate(magnetic, None), turning_rate(7.0, None)) == (0.0, 7.0)
    assert strength_unit((magnetic, 7.0)) == "mT"
    assert strength_unit((7.0, electric)) == "V/cm"
    assert strength_unit((7.0,)) == "mT"


@pytest.mark.parametrize("a", [{}, {"per_mT": 1, "per_V_cm": 1}])
def test_a_turning_rate_per_strength_is_given_in_exactly_one_unit(a):
    field, message = problem_of(contents([{"a": a}], strength=2))
    assert field == "robots.0.a.per_mT"
    assert "only one of them" in message


def test_a_strength_is_needed_only_by_rates_that_depend_on_it():
    made([{"a": 3}])
    made([{"a": {"per_mT": 1}}], strength=2)
    for robots in ([{"a": {"per_mT": 1}}], [{}, {"a": {"per_mT": 1}}]):
        field, message = problem_of(contents(robots))
        assert field == "strength"
        assert "given per mT" in message


# packages, representation


def test_the_packages_of_a_spec_are_those_that_provide_its_kinds(monkeypatch):
    assert find_packages(made()) == {}
    kind = CONTROLLERS.kind

    def foreign(name):
        return Kind(name, "x:Y", "tetractl-foreign", "1.2") if name == "mpc" else kind(name)

    monkeypatch.setattr(CONTROLLERS, "kind", foreign)
    assert find_packages(made()) == {"tetractl-foreign": "1.2"}
    assert find_packages(made(controller={"type": "pso-mpc"})) == {}


@pytest.mark.usefixtures("marks")
def test_the_package_of_the_rule_that_finds_robots_is_named(monkeypatch):
    experiment = parse_contents(with_marks(), "s").experiment
    monkeypatch.setattr(TRIAL_ROBOTS, "kind", lambda name: Kind(name, "x:Y", f"of-{name}", "3"))
    assert find_packages(experiment) == {"of-marks": "3"}
    assert find_packages(made()) == {}


def test_only_a_controller_of_given_directions_gives_them():
    assert not made().gives_directions
    given_ones = {"type": "sequence", "directions": [0.0, 1.0]}
    assert made(controller=given_ones).gives_directions


def test_a_spec_is_shown_by_its_name_plant_and_trials():
    text = repr(made(trials={"count": 7}))
    assert "name='s'" in text
    assert "plant='sim'" in text
    assert "trials=7" in text


def test_an_experiment_survives_a_dump():
    experiment = made(**WHEELS, on_lost="drop", hold={"radius": 5, "time": 1})
    dumped = json.loads(experiment.model_dump_json())
    assert Experiment.model_validate(dumped) == experiment
