"""Tests of the field's strength B, and of turning rates a = alpha B."""

import pytest

from tetractl.spec.identified import Identified, IdentifiedRobot, merge_identified
from tetractl.spec.load import parse_spec
from tetractl.spec.loaded_spec import resolved_yaml
from tetractl.spec.yaml.document import parse_document
from tetractl.spec.yaml.problems import InvalidSpecError

SPEC = """
name: x
strength: 2.0
arena: {left: 0, bottom: 0, width: 100, height: 100}
robots:
  - {name: r, start: [10, 50], target: [30, 50], a: {per_mT: 0.74}, speed: 20}
  - {name: s, start: [10, 60], target: [30, 60], a: 3, speed: 20}
"""


def setup_of(*sets):
    return parse_spec(SPEC, "x.yaml", sets).experiment.setup


def test_a_is_alpha_times_the_strength():
    setup = setup_of()
    assert setup.strength == 2.0
    assert setup.strength_unit == "mT"
    assert setup.a.tolist() == [0.74 * 2, 3]
    assert setup_of("strength=11").a.tolist() == [0.74 * 11, 3]


def test_the_strength_of_an_electric_field_is_in_volts_per_centimetre():
    setup = setup_of("robots.r.a={per_V_cm: 0.5}")
    assert setup.a[0] == 0.5 * 2
    assert setup.strength_unit == "V/cm"


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        (
            "strength=null",
            "strength: null: is missing, because the a of robots is given per mT: add it",
        ),
        ("strength=0", "strength: 0: must be greater than 0"),
        (
            "robots.s.a={per_V_cm: 1}",
            "robots: have rates a per mT and rates a per V/cm, but one field steers all robots",
        ),
        ("robots.r.a=-1", "robots.0.a: -1: must be greater than 0"),
        ("robots.r.a={per_mT: 0}", "robots.0.a.per_mT: must be greater than 0"),
        (
            "robots.r.a={}",
            "robots.0.a.per_mT: give either per_mT or per_V_cm, and only one of them",
        ),
        ("robots.r.a={per_mt: 1}", "robots.0.a.per_mt: unknown key; did you mean 'per_mT'?"),
    ],
)
def test_what_cannot_be_is_one_clear_line(setting, says):
    with pytest.raises(InvalidSpecError) as caught:
        parse_spec(SPEC, "x.yaml", [setting])
    (problem,) = caught.value.problems
    assert str(problem).endswith(f": {says}")


def identified(strength):
    """Robots with a of 4 rad/s, identified from logs with this strength [mT]."""
    values = {quantity: {"value": 1.0} for quantity in IdentifiedRobot.model_fields} | {
        "a": {"value": 4.0}
    }
    return Identified.model_validate(
        {
            "identified": "",
            "origin": "lab",
            "unit": "mm",
            "dead_time": {"value": 0.1},
            "robots": {"r": values, "s": values},
            "strength": strength,
        }
    )


def test_an_identified_rate_replaces_alpha_by_that_at_the_strength_of_its_logs():
    document = parse_document(SPEC, "x.yaml")
    merge_identified(document, identified(8.0), "found.yaml", identifies_robots=True)
    rates = [robot["a"] for robot in document.data["robots"]]
    assert rates == [{"per_mT": 4.0 / 8.0}, 4.0]


def test_what_is_resolved_loads_as_the_same_spec():
    loaded = parse_spec(SPEC, "x.yaml")
    assert "a: {per_mT: 0.74}" in loaded.resolved
    again = parse_spec(loaded.resolved, "again")
    assert again.experiment == loaded.experiment
    assert again.hash == loaded.hash


def test_a_spec_without_a_strength_is_dumped_as_ever():
    plain = parse_spec(SPEC, "x.yaml", ["robots.r.a=2", "strength=null"]).experiment
    assert "strength" not in resolved_yaml(plain)


def test_an_identified_rate_of_unknown_strength_cannot_replace_alpha():
    document = parse_document(SPEC, "x.yaml")
    merge_identified(document, identified(None), "found.yaml", identifies_robots=True)
    (problem,) = document.problems
    assert "the logs from which this value comes do not state a strength" in str(problem)
