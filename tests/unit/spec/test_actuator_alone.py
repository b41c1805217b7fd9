"""The actuator of a spec that is wrong elsewhere."""

import pytest

from tetractl.core.clock import VirtualClock
from tetractl.spec.actuator_alone import actuator_alone
from tetractl.spec.yaml.document import parse_document

TWIST = "{type: twist, port: a, robots: [{name: green}, {name: blue, port: b}]}"
M3PI = "{type: m3pi-xbee, port: a, robots: [{name: green}, {name: blue}]}"


@pytest.mark.parametrize("actuator", [TWIST, M3PI])
@pytest.mark.parametrize("section", ["plant", "lab"])
def test_robots_are_those_of_the_actuator(section, actuator):
    alone = actuator_alone(parse_document(f"{section}: {{actuator: {actuator}}}", "spec.yaml"))
    actuator_section, setup = alone
    assert setup.names == ("green", "blue")
    actuator_section.build(setup, VirtualClock())
