"""Makes the controller a spec asks for."""

from collections.abc import Callable
from threading import Timer

import numpy as np

from tetractl.control.cost import Problem
from tetractl.control.mpc import PsoMpc
from tetractl.control.optimizers.compiled import pso
from tetractl.control.optimizers.multistart import multistart
from tetractl.control.optimizers.pso import Searcher
from tetractl.core.protocols import Controller
from tetractl.experiment.controller import MultistartSpec
from tetractl.experiment.experiment import Experiment

ANNOUNCE_AFTER_S = 1.0


def searcher(experiment: Experiment) -> Searcher:
    """Return the optimiser that the spec asks for."""
    if isinstance(experiment.controller.swarm, MultistartSpec):
        return multistart
    return pso


def build_controller(experiment: Experiment, key: int) -> Controller:
    """Return the controller of one trial; `key` is the root of its random draws."""
    return PsoMpc(experiment, key, searcher(experiment))


def warm_up(experiment: Experiment, announce: Callable[[str], None]) -> None:
    """Compile, or load from the cache, what the controller runs; `announce` says if it takes long.

    Compilation happens once a machine and version; the result is kept on disk.
    """
    notice = Timer(ANNOUNCE_AFTER_S, announce, ["compiling the solver, once on this machine ..."])
    notice.daemon = True
    notice.start()
    try:
        problem, swarm = Problem.of(experiment), experiment.controller.swarm
        searcher(experiment)(problem, 1, np.zeros(1), swarm, key=0)
    finally:
        notice.cancel()
