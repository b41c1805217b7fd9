"""Makes the controller that a spec asks for, and compiles what it runs."""

from collections.abc import Callable
from threading import Timer

from tetractl.core.protocols import Controller
from tetractl.experiment.experiment import Experiment

ANNOUNCE_AFTER_S = 1.0


def build_controller(experiment: Experiment, key: int) -> Controller:
    """Return the controller of one trial; `key` is the root of its random draws."""
    return experiment.controller.build(experiment.setup, key)


def warm_up(experiment: Experiment, announce: Callable[[str], None]) -> None:
    """Compile, or load from the cache, what the controller runs; `announce` says if it takes long.

    Compilation happens once a machine and version; the result is kept on disk.
    """
    notice = Timer(ANNOUNCE_AFTER_S, announce, ["compiling the solver, once on this machine ..."])
    notice.daemon = True
    notice.start()
    try:
        experiment.controller.warm_up(experiment.setup)
    finally:
        notice.cancel()
