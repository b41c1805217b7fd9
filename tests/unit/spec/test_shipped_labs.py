"""Tests that shipped lab specs describe devices in the same way as `tetractl init --lab`."""

import pytest

from tetractl.spec.examples import find_examples
from tetractl.spec.lab_template import lab_template
from tetractl.spec.load import parse_spec
from tetractl.spec.yaml.document import read_document
from tetractl.spec.yaml.spec_files import read_text

LABS = {name: file for name, file in find_examples().items() if "lab" in read_document(file).data}
WITHOUT_TEMPLATE = "field"
"""The actuator without a template: its values depend on the coils."""


def of_devices(experiment):
    """What a spec says of devices and robots' bodies, apart from who the robots are."""
    lab = experiment.lab.model_dump()
    for device in ("camera", "actuator"):
        del lab[device]["robots"]
    values = {
        "lab": lab,
        "wheels": experiment.wheels,
        "plant": experiment.plant,
        "dead_time": experiment.controller.dead_time,
    }
    if hasattr(experiment.controller, "collision"):
        values["collision"] = experiment.controller.collision
    return values


@pytest.mark.parametrize("name", LABS)
def test_a_shipped_lab_agrees_with_its_template(name):
    """Regression: three_m3pi_lab stated no lag, and its template 0.04 s."""
    shipped = parse_spec(read_text(LABS[name]), name).experiment
    robots = shipped.lab.actuator.type
    if robots == WITHOUT_TEMPLATE:
        return
    text = lab_template(robots, shipped.lab.camera.type).replace("@NAME@", "name: new")
    written = of_devices(parse_spec(text, "new").experiment)
    stated = of_devices(shipped)
    if "collision" not in stated:  # the published controller knows neither bodies nor delays
        del written["collision"], written["dead_time"], stated["dead_time"]
    assert stated == written
