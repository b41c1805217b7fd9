"""Makes the controller that a spec asks for, and compiles what it runs."""

import time
from collections.abc import Callable
from threading import Timer

from tetractl.core.protocols import Controller
from tetractl.experiment.experiment import Experiment

ANNOUNCE_AFTER_S = 1.0  # loading from the cache is not announced


def build_controller(experiment: Experiment, key: int) -> Controller:
    """Return the controller of one trial; `key` is the root of its random draws."""
    return experiment.controller.build(experiment.setup, key)


def warm_up(experiment: Experiment, announce: Callable[[str], None]) -> None:
    """Compile, or load from the cache, what the controller runs; `announce` is called if compiling
    takes long.

    What is compiled depends on the kinds that the spec names, and is kept on disk for the next run
    of any spec that names the same.
    """
    began_s, said = time.monotonic(), list[str]()

    def say() -> None:
        said.append(compiled_for(experiment))
        announce(f"compiling for {said[0]}, some 10 to 40 s; kept for the next time ...")

    notice = Timer(ANNOUNCE_AFTER_S, say)
    notice.daemon = True
    notice.start()
    try:
        experiment.controller.warm_up(experiment.setup)
    finally:
        notice.cancel()
    if said:
        announce(f"compiled in {time.monotonic() - began_s:.0f} s")


def compiled_for(experiment: Experiment) -> str:
    """Return the kinds of a spec that decide what is compiled, such as "mpc, multistart, exact,
    circle".
    """
    control = experiment.controller
    optimizer = getattr(getattr(control, "optimizer", None), "type", None)
    shapes = sorted({obstacle.type for obstacle in experiment.obstacles})
    kinds = (control.type, optimizer, getattr(control, "motion", None), *shapes)
    return ", ".join(kind for kind in kinds if kind)
