"""What `lab calibrate` refuses before a device is opened."""

from types import SimpleNamespace

import pytest
from testkit.lab_specs import SPEC

from tetractl.core.errors import AbortError
from tetractl.spec.load import parse_spec
from tetractl.spec.plants import on_plant


class SteeringActuator:
    """An actuator of which nothing says that its robots have wheels; it is never opened."""


def test_an_actuator_without_wheels_is_not_calibrated():
    """Regression: an assertion failed; under `python -O` the robots were driven at the spec's
    speed, whatever the limit."""
    experiment = on_plant(parse_spec(SPEC, "lab.yaml"), "lab").experiment
    lab = experiment.plant
    rig = SimpleNamespace(actuator=SteeringActuator())
    name = experiment.setup.names[0]
    arguments = lab, lambda limits, setup: rig, experiment.setup, [name], 45, print
    with pytest.raises(AbortError, match="SteeringActuator cannot be calibrated"):
        lab.actuator.calibrate(*arguments)
