"""Tests that every kind of tetractl passes the checks that plug-ins must pass."""

import pytest
from testkit.controllers import CONTROLLERS, SMALL
from tetractl_testing import (
    check_controller,
    check_disturbance,
    check_motion,
    check_optimizer,
    check_shape,
)

from tetractl.cli.specs import build_template
from tetractl.core import registries
from tetractl.core.registries import DISTURBANCES, MOTIONS, OPTIMIZERS
from tetractl.model.shapes import Circle, Polygon, Rectangle
from tetractl.spec.load import parse_spec

pytestmark = pytest.mark.slow

SETUP = parse_spec(build_template("check", "check"), "check").experiment.setup
SHAPES = {
    "circle": Circle(type="circle", center=(3.0, -2.0), radius=40.0),
    "rectangle": Rectangle(type="rectangle", left=-5, bottom=2, width=30, height=12),
    "polygon": Polygon(type="polygon", vertices=((0, 0), (10, 0), (10, 10), (5, 3))),
}
FIELDS = {
    "battery": {"speed": 0.2},
    "camera-latency": {"mean": 0.01},
    "flow": {"speed": 10},
    "heading-drift": {"rate": 0.1},
    "frame-loss": {"share": 0.1},
    "frozen-camera": {"duration": 0.2},
    "marker-off": {"heading": 0.1},
    "planning-time": {"least": 0.01},
    "silent-radio": {"duration": 0.2},
    "stale-camera": {"duration": 0.2, "age": 0.2},
    "sticking": {"every": 1},
    "tracking-loss": {"every": 1},
    "wobble": {"radius": 3, "frequency": 2},
}


@pytest.mark.parametrize("name", MOTIONS.builtin)
def test_motion(name):
    check_motion(MOTIONS.load(name))


@pytest.mark.parametrize("name", registries.SHAPES.builtin)
def test_shape(name):
    check_shape(SHAPES[name], SETUP)


@pytest.mark.parametrize("name", OPTIMIZERS.builtin)
def test_optimizer(name):
    section = OPTIMIZERS.load(name).model_validate({"type": name} | SMALL[name])
    check_optimizer(section, SETUP)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_controller(name):
    fields = CONTROLLERS[name]
    section = registries.CONTROLLERS.load(fields["type"]).model_validate(fields)
    check_controller(section, SETUP)


@pytest.mark.parametrize("name", DISTURBANCES.builtin)
def test_disturbance(name):
    section = DISTURBANCES.load(name).model_validate({"type": name} | FIELDS.get(name, {}))
    check_disturbance(section, SETUP)
