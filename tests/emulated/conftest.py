"""What every play of an emulated lab needs first."""

import pytest
from support.lab_processes import SMALL, SPEC

from tetractl.control.build import warm_up
from tetractl.experiment.load import load_spec


@pytest.fixture(autouse=True, scope="session")
def compiled_controller():
    """Compile the controller before the plays: a minute of it would count as one that hangs."""
    warm_up(load_spec(SPEC, SMALL).experiment, print)
