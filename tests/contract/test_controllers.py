"""Tests of what every controller of tetractl must do."""

import pytest
from testkit.controller_promises import ControllerPromises
from testkit.controllers import CONTROLLERS

pytestmark = pytest.mark.slow


@pytest.fixture(params=CONTROLLERS.values(), ids=list(CONTROLLERS))
def fields(request):
    return {"arrival_tolerance": 20} | request.param


class TestControllers(ControllerPromises):
    """Each of them."""
