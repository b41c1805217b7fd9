"""Tests of the file of identified values, and of the values of a spec that it replaces."""

import pytest
import yaml

from tetractl.spec.identified import Identified, IdentifiedRobot, merge_identified, read_identified
from tetractl.spec.load import load_spec
from tetractl.spec.yaml.document import parse_document
from tetractl.spec.yaml.problems import InvalidSpecError

ONES = {quantity: {"value": 1.0} for quantity in IdentifiedRobot.model_fields}
FOUND = {
    "identified": "now",
    "origin": "lab",
    "unit": "mm",
    "dead_time": {"value": 0.1, "low": 0.05, "high": 0.15},
    "frame_age": 0.03,
    "robots": {
        "one": ONES | {"a": {"value": 4.0}, "speed": {"value": 90.0}},
        "two": ONES | {"a": {"value": 2.0}, "speed": {"value": 70.0}},
    },
}
SPEC = """
name: s
arena: {left: 0, bottom: 0, width: 100, height: 100}
robots:
  - {name: two, start: [10, 50], target: [30, 50], a: 3, speed: 20, heading: 0.5}
  - {name: one, start: [10, 60], target: [30, 60], a: 3, speed: 20}
"""


def written(folder, **changes):
    path = folder / "found.yaml"
    path.write_text(yaml.safe_dump(FOUND | changes))
    return path


def merged(text=SPEC, estimates=True, **changes):
    document = parse_document(text, "s.yaml")
    merge_identified(document, Identified.model_validate(FOUND | changes), "found.yaml", estimates)
    return document


def test_a_file_is_read_with_its_text(tmp_path):
    path = written(tmp_path)
    identified, text = read_identified(path)
    assert text == path.read_text()
    assert identified.robots["two"].speed.value == 70.0
    assert (identified.dead_time.low, identified.dead_time.high) == (0.05, 0.15)


@pytest.mark.parametrize(
    ("quantity", "value", "says"),
    [
        ("a", 0.0, "must be greater than 0"),
        ("a", -1.0, "must be greater than 0"),
        ("a", 1e-9, ""),
        ("speed", -0.1, "must be at least 0"),
        ("speed", 0.0, ""),
        ("heading_bias", -1.0, ""),
    ],
)
def test_rates_are_positive_and_speeds_not_negative(tmp_path, quantity, value, says):
    robots = FOUND["robots"] | {"two": ONES | {quantity: {"value": value}}}
    path = written(tmp_path, robots=robots)
    if not says:
        assert getattr(read_identified(path)[0].robots["two"], quantity).value == value
        return
    with pytest.raises(InvalidSpecError) as caught:
        read_identified(path)
    (problem,) = caught.value.problems
    assert (problem.field, problem.message) == (f"robots.two.{quantity}.value", says)
    assert problem.line is not None


def test_the_values_of_each_robot_replace_those_of_the_robot_with_its_name():
    document = merged()
    assert document.all_problems == []
    two, one = document.data["robots"]
    assert (two["name"], two["a"], two["speed"], two["heading"]) == ("two", 2.0, 70.0, 0.5)
    assert (one["name"], one["a"], one["speed"]) == ("one", 4.0, 90.0)
    assert document.places["robots", 0, "a"].origin == "found.yaml"
    assert document.places["robots", 0, "heading"].origin == "s.yaml"


def test_a_robot_that_was_not_identified_keeps_its_values():
    document = merged(robots={"one": FOUND["robots"]["one"]})
    assert document.all_problems == []
    assert [robot["a"] for robot in document.data["robots"]] == [3, 4.0]


def test_an_identified_robot_that_the_spec_lacks_is_a_problem():
    (problem,) = merged(robots=FOUND["robots"] | {"six": ONES}).all_problems
    assert (problem.origin, problem.field) == ("found.yaml", "robots.six")
    assert problem.message == "is not a robot of the spec"


@pytest.mark.parametrize(("estimates", "dead_time_s"), [(True, 0.1), (False, 0.13)])
def test_the_dead_time_counts_from_the_frame_unless_it_is_estimated(estimates, dead_time_s):
    controller = merged(estimates=estimates).data["controller"]
    assert controller["dead_time"] == pytest.approx(dead_time_s)


def test_a_controller_keeps_its_other_fields():
    controller = merged(SPEC + "controller: {type: mpc, period: 0.1, dead_time: 9}\n").data[
        "controller"
    ]
    assert controller == {"type": "mpc", "period": 0.1, "dead_time": 0.1}


@pytest.mark.parametrize("units", ["", "units: {}\n", "units: {length: mm}\n", "units: 5\n"])
def test_a_spec_is_in_millimetres_unless_it_says_otherwise(units):
    assert merged(SPEC + units).all_problems == []


@pytest.mark.parametrize(("units", "unit"), [("{length: cm}", "mm"), ("{}", "um"), ("{}", "cm")])
def test_values_in_another_unit_are_not_taken(units, unit):
    document = merged(f"{SPEC}units: {units}\n", unit=unit)
    (problem,) = document.all_problems
    assert problem.field == "unit"
    assert problem.value == unit
    assert document.data["robots"][0]["a"] == 3
    assert "controller" not in document.data


WITH_ALPHA = SPEC.replace("a: 3, speed: 20, h", "a: {per_mT: 0.5}, speed: 20, h")


def test_a_rate_per_strength_is_that_at_the_strength_of_the_logs():
    two, one = merged(WITH_ALPHA, strength=4.0).data["robots"]
    assert two["a"] == {"per_mT": 0.5}  # 2 rad/s at 4 mT
    assert one["a"] == 4.0
    two, _ = merged(WITH_ALPHA, strength=0.5).data["robots"]
    assert two["a"] == {"per_mT": 4.0}


def test_a_rate_per_strength_needs_the_strength_of_the_logs():
    (problem,) = merged(WITH_ALPHA).all_problems
    assert problem.field == "robots.0.a"
    assert "do not state a strength" in problem.message


def test_a_spec_takes_the_values_of_the_file_that_it_names(tmp_path):
    written(tmp_path)
    path = tmp_path / "s.yaml"
    path.write_text(SPEC + "identified: found.yaml\n")
    loaded = load_spec(path, ["robots.one.a=9"])
    assert loaded.experiment.setup.a.tolist() == [2.0, 9.0]  # a setting counts more
    assert loaded.experiment.setup.speed.tolist() == [70.0, 90.0]
    assert loaded.experiment.identified is None
    assert loaded.attached == (("found.yaml", (tmp_path / "found.yaml").read_text()),)


def test_a_missing_file_is_one_line(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_text(SPEC + "identified: gone.yaml\n")
    with pytest.raises(InvalidSpecError, match=r"gone\.yaml: there is no such file"):
        load_spec(path)
