"""Tests of reading only the actuator of a spec that is wrong elsewhere."""

import pytest

from tetractl.core.clock import VirtualClock
from tetractl.spec.actuator_alone import load_actuator_alone
from tetractl.spec.yaml.document import parse_document

TWIST = "{type: twist, port: a, robots: [{name: green}, {name: blue, port: b}]}"
M3PI = "{type: m3pi-xbee, port: a, robots: [{name: green}, {name: blue}]}"


@pytest.mark.parametrize("actuator", [TWIST, M3PI])
@pytest.mark.parametrize("section", ["plant", "lab"])
def test_robots_are_those_of_the_actuator(section, actuator):
    alone = load_actuator_alone(parse_document(f"{section}: {{actuator: {actuator}}}", "spec.yaml"))
    actuator_section, setup = alone
    assert setup.names == ("green", "blue")
    actuator_section.build(setup, VirtualClock())


def test_a_real_lab_is_that_of_the_plant_if_both_have_an_actuator():
    """As of a spec without errors: `lab` is for specs whose plant is a simulation."""
    lab = TWIST.replace("green", "red")
    text = f"plant: {{actuator: {TWIST}}}\nlab: {{actuator: {lab}}}"
    alone = load_actuator_alone(parse_document(text, "spec.yaml"))
    assert alone is not None
    assert alone[1].names == ("green", "blue")


@pytest.mark.parametrize(
    "text",
    [
        "name: a",
        "lab: 3",
        "lab: {camera: {}}",
        "lab: {actuator: 3}",
        "lab: {actuator: {type: none-such}}",
        f"lab: {{actuator: {TWIST.replace('port: a', 'port: 3')}}}",
    ],
)
def test_an_actuator_that_is_missing_or_invalid_is_none(text):
    assert load_actuator_alone(parse_document(text, "spec.yaml")) is None
