"""Tests that the papers' controllers pass the checks that every plug-in must pass."""

import pytest
from testkit.controller_promises import ControllerPromises, experiment_of
from tetractl_testing import check_controller

pytestmark = pytest.mark.slow

CONTROLLERS = {"ensemble": {"type": "ensemble"}, "rrt": {"type": "rrt", "margin": 40}}


@pytest.fixture(params=CONTROLLERS.values(), ids=list(CONTROLLERS))
def fields(request):
    return {"arrival_tolerance": 20} | request.param


class TestControllers(ControllerPromises):
    """Each of them."""


def test_it_passes_the_checks_of_plug_ins(fields):
    spec = experiment_of(fields)
    check_controller(spec.controller, spec.setup)
