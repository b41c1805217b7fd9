"""Makes the controller a spec asks for."""

from tetractl.control.mpc import PsoMpc
from tetractl.control.plan import Controller
from tetractl.spec.experiment import Experiment


def build_controller(experiment: Experiment, key: int) -> Controller:
    """Return the controller of one trial; `key` is the root of its random draws."""
    return PsoMpc(experiment, key)
