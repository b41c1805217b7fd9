"""Tests of the rules between the parts of a spec: what is refused, where, and what passes."""

import json
from copy import deepcopy

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit.marked_robots import MarkedRobots
from testkit.paths import ROOT

from tetractl.spec.consistency import (
    SpecFinding,
    find_errors,
    find_nearest,
    find_overlapping,
    find_same_names,
    find_section_errors,
    find_unreachable,
)
from tetractl.spec.load import load_spec, parse_contents, parse_resolved
from tetractl.spec.yaml.problems import InvalidSpecError

CONTENTS = {
    "name": "s",
    "arena": {"left": -20, "bottom": 10, "width": 100, "height": 60},
    "robots": [
        {"name": "one", "start": [0, 20], "target": [60, 20], "a": 3, "speed": 20},
        {"name": "two", "start": [0, 40], "target": [60, 40], "a": 4, "speed": 20},
        {"name": "three", "start": [0, 60], "target": [60, 60], "a": 5, "speed": 20},
    ],
    "wheels": {"radius": 5},
}
BODIES = {"type": "mpc", "collision": {"radius": 5}}


def contents(robots=(), **changes):
    """The contents of the spec above, with other fields, and with changes of its robots."""
    changed = deepcopy(CONTENTS) | changes
    for robot, change in zip(changed["robots"], robots, strict=False):
        robot.update(change)
    return changed


def refused(spec):
    """The field and the message of each problem of a spec; empty if it is valid."""
    try:
        parse_contents(spec, "s.yaml")
    except InvalidSpecError as error:
        return [(problem.field, problem.message) for problem in error.problems]
    return []


def fields(spec):
    return [field for field, _ in refused(spec)]


def test_the_spec_of_these_tests_is_valid():
    assert refused(CONTENTS) == []
    assert refused(contents(controller=BODIES)) == []


# names


def test_each_robot_with_an_earlier_name_is_found_and_the_first_one_is_named():
    problems = refused(contents([{"name": "a"}, {"name": "b"}, {"name": "a"}]))
    assert [field for field, _ in problems] == ["robots.2.name"]
    assert "already the name of robots.0" in problems[0][1]
    assert fields(contents([{"name": "a"}] * 3)) == ["robots.1.name", "robots.2.name"]


def test_names_that_differ_only_in_case_are_two_names():
    assert refused(contents([{"name": "a"}, {"name": "A"}])) == []


# places

X_MAX, Y_MAX = 80, 70  # -20 + 100 and 10 + 60


@pytest.mark.parametrize("place", ["start", "target"])
@pytest.mark.parametrize(
    "point", [[-20, 10], [-20, Y_MAX], [X_MAX, 10], [X_MAX, Y_MAX], [30, 10], [-20, 30]]
)
def test_a_place_on_the_edge_of_the_arena_is_allowed(place, point):
    assert refused(contents([{place: point}])) == []


@pytest.mark.parametrize("place", ["start", "target"])
@pytest.mark.parametrize("point", [[-20.1, 30], [X_MAX + 0.1, 30], [0, 9.9], [0, Y_MAX + 0.1]])
def test_a_place_beyond_any_side_of_the_arena_is_refused(place, point):
    ((field, message),) = refused(contents([{}, {place: point}]))
    assert field == f"robots.1.{place}"
    assert message.endswith("outside the arena; it must be within x -20 to 80, y 10 to 70")


def test_a_way_point_outside_the_arena_is_named_by_its_index():
    vias = [{"via": [[0, 30], [30, 30]]}, {"via": [[0, 45], [30, 200]]}, {"via": [[0, 65], [9, 9]]}]
    assert fields(contents(vias)) == ["robots.1.via.1", "robots.2.via.1"]


BOX = {"type": "rectangle", "left": 25, "bottom": 25, "width": 10, "height": 10}
DISC = {"type": "circle", "center": [30, 55], "radius": 4}


@pytest.mark.parametrize("place", ["start", "target"])
def test_a_place_in_an_obstacle_is_refused_with_the_obstacle(place):
    problems = refused(contents([{}, {place: [30, 52]}, {place: [27, 33]}], obstacles=[BOX, DISC]))
    assert [field for field, _ in problems] == [f"robots.1.{place}", f"robots.2.{place}"]
    assert "inside obstacles.1, a circle" in problems[0][1]
    assert "inside obstacles.0, a rectangle" in problems[1][1]


def test_a_way_point_in_an_obstacle_is_refused():
    vias = [{"via": [[0, 30]]}, {"via": [[30, 30]]}, {"via": [[0, 65]]}]
    assert fields(contents(vias, obstacles=[BOX])) == ["robots.1.via.0"]


def test_a_place_in_two_obstacles_is_refused_once_for_each():
    both = [BOX, BOX | {"left": 29}]
    assert fields(contents([{"target": [30, 30]}], obstacles=both)) == ["robots.0.target"] * 2


SURROUNDING = {"type": "rectangle", "left": -500, "bottom": -500, "width": 999, "height": 200}


@pytest.mark.parametrize(
    ("left", "bottom", "is_refused"),
    [
        (-31, 30, True),
        (81, 30, True),
        (30, -1, True),
        (30, 71, True),
        (-25, 30, False),
        (75, 30, False),
        (30, 5, False),
        (30, 65, False),
        (76, 66, False),
        (30, 30, False),
    ],
)
def test_only_an_obstacle_that_meets_no_part_of_the_arena_is_refused(left, bottom, is_refused):
    spec = contents(obstacles=[DISC, BOX | {"left": left, "bottom": bottom}])
    assert fields(spec) == (["obstacles.1"] if is_refused else [])


def test_an_obstacle_that_crosses_the_whole_arena_without_a_corner_in_it_is_allowed():
    beam = {"type": "rectangle", "left": -500, "bottom": 64, "width": 1000, "height": 3}
    assert refused(contents(obstacles=[beam])) == []
    message = dict(refused(contents(obstacles=[SURROUNDING])))["obstacles.0"]
    assert message == "is entirely outside the arena, which is x -20 to 80, y 10 to 70"


# bodies at the starts, way-points and targets


@pytest.mark.parametrize(("gap", "is_refused"), [(9.99, True), (10, False), (10.01, False)])
@pytest.mark.parametrize(("place", "x"), [("start", 0), ("target", 60)])
def test_bodies_may_touch_but_not_overlap(gap, is_refused, place, x):
    spec = contents([{}, {place: [x, 20 + gap]}], controller=BODIES)
    assert fields(spec) == ([f"robots.1.{place}"] if is_refused else [])


@pytest.mark.parametrize(("overlap", "is_refused"), [(1e-9, False), (1e-6, True)])
def test_bodies_that_touch_within_rounding_are_allowed(overlap, is_refused):
    spec = contents([{"start": [0, 20]}, {"start": [0, 30 - overlap]}], controller=BODIES)
    assert fields(spec) == (["robots.1.start"] if is_refused else [])


def test_bodies_that_overlap_at_a_way_point_are_refused():
    vias = [{"via": [[20, 20], [40, 30]]}, {"via": [[20, 40], [40, 33]]}, {"via": [[20, 60]] * 2}]
    ((field, message),) = refused(contents(vias, controller=BODIES))
    assert field == "robots.1.via.1"
    assert message.startswith("is 3 mm from the way-point of one: bodies of radius 5 overlap")


def test_an_overlap_names_the_nearest_earlier_robot():
    spec = contents([{"start": [0, 20]}, {"start": [0, 34]}, {"start": [0, 28]}])
    ((field, message),) = refused(spec | {"controller": BODIES})
    assert field == "robots.2.start"
    assert message.startswith("is 6 mm from the start of two: ")


def test_points_without_bodies_may_share_a_place():
    assert refused(contents([{"target": [60, 40]}])) == []


SETUP = parse_contents(CONTENTS, "s.yaml").experiment.setup


@given(st.integers(0, 10_000))
def test_the_nearest_earlier_robot_is_the_one_of_a_search_through_all(seed):
    points = np.random.default_rng(seed).uniform(-50, 50, (3, 2))
    found = list(find_nearest(SETUP, points))
    assert [i for i, _, _ in found] == [1, 2]
    for i, name, distance in found:
        gaps = {SETUP.names[k]: float(np.linalg.norm(points[k] - points[i])) for k in range(i)}
        assert name == min(gaps, key=lambda one: gaps[one])
        assert distance == pytest.approx(gaps[name])


# targets that a body does not fit into


@pytest.mark.parametrize(
    ("target", "is_refused"),
    [
        ([X_MAX - 4.9, 20], True),
        ([X_MAX - 5, 20], False),
        ([-15.1, 20], True),
        ([-15, 20], False),
        ([60, 14.9], True),
        ([60, 15], False),
    ],
)
def test_a_body_must_fit_between_its_target_and_the_edge(target, is_refused):
    spec = contents([{"target": target}], controller=BODIES)
    assert fields(spec) == (["robots.0.target"] if is_refused else [])


def test_a_body_may_reach_over_the_edge_where_plans_keep_no_distance_to_walls():
    no_walls = {"type": "mpc", "collision": {"radius": 5, "walls": False}}
    assert refused(contents([{"target": [78, 20]}], controller=no_walls)) == []
    near_box = contents([{"target": [38, 30]}], obstacles=[BOX], controller=no_walls)
    ((field, message),) = refused(near_box)
    assert field == "robots.0.target"
    assert message.startswith("is 3 mm from the nearest obstacle or edge: a body of radius 5 does")


@pytest.mark.parametrize(("x", "is_refused"), [(39.9, True), (40, False)])
def test_a_body_must_fit_between_its_target_and_each_obstacle(x, is_refused):
    for obstacles in ([BOX, DISC], [DISC, BOX]):
        spec = contents([{"target": [x, 30]}], obstacles=obstacles, controller=BODIES)
        assert fields(spec) == (["robots.0.target"] if is_refused else [])


@pytest.mark.parametrize("target", [[30, 30], [-30, 30]])
def test_a_target_that_is_misplaced_is_reported_only_as_that(target):
    spec = contents([{"target": target}], obstacles=[BOX], controller=BODIES)
    ((field, message),) = refused(spec)
    assert field == "robots.0.target"
    assert "does not fit" not in message


def test_starts_need_no_free_space_around_them():
    assert refused(contents([{"start": [-19, 20]}], controller=BODIES)) == []


def test_a_published_controller_has_no_bodies_that_could_overlap():
    spec = contents([{"start": [0, 40], "target": [-20, 20]}], controller={"type": "pso-mpc"})
    assert refused(spec) == []


# sections


def test_a_controller_that_cannot_tour_refuses_way_points_and_a_hold():
    vias = [{"via": [[20, 20]]}, {"via": [[20, 40]]}, {"via": [[20, 60]]}]
    hold = {"hold": {"radius": 5, "time": 10}}
    published = {"controller": {"type": "pso-mpc"}}
    for spec in (contents(vias, **published), contents(**hold, **published)):
        ((field, message),) = refused(spec)
        assert field == "controller"
        assert "pso-mpc supports neither way-points nor a hold" in message
    assert refused(contents(vias)) == []
    assert refused(contents(**hold)) == []
    assert refused(contents(**published)) == []


def changed(experiment, **fields):
    return experiment.model_copy(update=fields)


@pytest.mark.parametrize("by_controller", [False, True])
@pytest.mark.parametrize("by_plant", [False, True])
def test_only_a_field_that_is_switched_needs_a_plant_that_switches_it(by_controller, by_plant):
    experiment = parse_contents(CONTENTS, "s.yaml").experiment
    controller = type("C", (type(experiment.controller),), {"switches_field": by_controller})()
    plant = type("P", (type(experiment.plant),), {"switches_field": by_plant})()
    found = list(find_section_errors(changed(experiment, controller=controller, plant=plant)))
    places = [finding.loc for finding in found]
    assert places == ([("plant",)] if by_controller and not by_plant else [])


def test_contradictions_of_each_section_are_placed_in_it():
    experiment = parse_contents(CONTENTS, "s.yaml").experiment

    def contradictions(self, setup):
        yield ("inner", 1), f"differs from {setup.name}"

    wrong = {"contradictions": contradictions}
    controller = type("C", (type(experiment.controller),), wrong)()
    plant = type("P", (type(experiment.plant),), wrong)()
    found = list(find_section_errors(changed(experiment, controller=controller, plant=plant)))
    assert [finding.loc for finding in found] == [
        ("controller", "inner", 1),
        ("plant", "inner", 1),
    ]
    assert {finding.text for finding in found} == {"differs from s"}


# memory


@pytest.mark.parametrize(
    ("numbers", "is_refused"), [(1.24e8, False), (1.25e8, False), (1.26e8, True)]
)
def test_a_control_step_may_hold_one_gigabyte_of_numbers(numbers, is_refused):
    experiment = parse_contents(CONTENTS, "s.yaml").experiment
    held = {"numbers_held": lambda self, setup: numbers}
    controller = type("C", (type(experiment.controller),), held)()
    found = list(find_errors(changed(experiment, controller=controller), is_resolved=True))
    assert [finding.loc for finding in found] == ([("controller",)] if is_refused else [])
    if is_refused:
        assert "about 1.01 GB of memory, more than 1 GB" in found[0].text


# specs in logs


def test_the_places_in_a_log_are_not_checked_but_its_names_and_sections_are():
    spec = contents([{"start": [-99, 20]}, {"start": [-99, 20], "target": [78, 40]}])
    spec |= {"controller": BODIES, "obstacles": [BOX | {"left": 999}]}
    assert len(refused(spec)) > 3
    assert parse_resolved(json.dumps(spec), "log").experiment.robots[0].start == (-99, 20)
    same = contents([{"name": "a"}] * 2, controller={"type": "pso-mpc"}, hold=None)
    same["hold"] = {"radius": 5, "time": 10}
    with pytest.raises(InvalidSpecError) as caught:
        parse_resolved(json.dumps(same), "log")
    assert {problem.field for problem in caught.value.problems} == {"controller", "robots.1.name"}


def test_each_rule_alone_finds_nothing_in_a_valid_spec():
    experiment = parse_contents(contents(controller=BODIES, obstacles=[BOX]), "s").experiment
    for rule in (find_same_names, find_section_errors, find_overlapping, find_unreachable):
        assert list(rule(experiment)) == []


def test_a_finding_is_printed_with_its_hint_if_it_has_one():
    assert str(SpecFinding(("robots",), "is wrong")) == "is wrong"
    assert str(SpecFinding(("robots",), "is wrong", "do this")) == "is wrong; do this"


# labs whose trials find their robots


LAB = ROOT / "experiments/three_m3pi_lab.yaml"


def test_a_lab_must_be_able_to_choose_robots_only_if_trials_find_theirs(monkeypatch):
    experiment = load_spec(LAB).experiment
    assert list(find_section_errors(experiment)) == []
    chosen = MarkedRobots(marks=((900, 800),))
    findings = list(find_section_errors(experiment.model_copy(update={"chosen": chosen})))
    assert [finding.loc for finding in findings] == [("lab", "camera"), ("lab", "actuator")]
    assert "optitrack cannot choose the robots of a trial" in findings[0].text
    for device in (type(experiment.lab.camera), type(experiment.lab.actuator)):
        monkeypatch.setattr(device, "settles", True)
    assert list(find_section_errors(experiment.model_copy(update={"chosen": chosen}))) == []


def test_the_places_of_stand_ins_are_not_checked():
    """They all wait in the middle of the arena, where an obstacle may be."""
    box = BOX | {"left": 0, "bottom": 12, "width": 70, "height": 56}
    experiment = parse_contents(CONTENTS, "s.yaml").experiment
    shape = parse_contents(contents(obstacles=[BOX]), "s").experiment.obstacles[0]
    around = shape.model_copy(update={key: box[key] for key in ("left", "bottom", "width")})
    robots = tuple(
        robot.model_copy(update={"start": (30, 40), "target": (30, 40)})
        for robot in experiment.robots
    )
    controller = parse_contents(contents(controller=BODIES), "s").experiment.controller
    placed = experiment.model_copy(
        update={"robots": robots, "obstacles": (around,), "controller": controller}
    )
    assert list(find_errors(placed, is_resolved=False)) != []
    chosen = MarkedRobots(marks=((0, 0),))
    assert list(find_errors(placed.model_copy(update={"chosen": chosen}), is_resolved=False)) == []
