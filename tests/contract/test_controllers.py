"""What every controller of tetractl promises."""

import pytest
from support.controller_promises import ControllerPromises
from support.controllers import CONTROLLERS

pytestmark = pytest.mark.slow


@pytest.fixture(params=CONTROLLERS.values(), ids=list(CONTROLLERS))
def fields(request):
    return {"arrival_tolerance": 20} | request.param


class TestControllers(ControllerPromises):
    """Each of them."""
