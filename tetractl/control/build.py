"""Builds the controller of a spec, and compiles the functions that it runs."""

import time
from collections.abc import Callable
from threading import Timer

from tetractl.core.protocols import Controller
from tetractl.experiment.experiment import Experiment

ANNOUNCE_AFTER_S = 1.0  # longer than loading from the cache takes [s]


def build_controller(experiment: Experiment, key: int) -> Controller:
    """Return the controller of one trial; `key` is the root of its random draws."""
    return experiment.controller.build(experiment.setup, key)


def warm_up(experiment: Experiment, announce: Callable[[str], None]) -> None:
    """Compile the functions that the controller runs, or load them from the cache; `announce` is
    called if that takes long.

    Compiled code is kept on disk for all specs that name the same kinds.
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
    """Return the kinds of a spec for which code is compiled: "mpc, multistart, exact, circle"."""
    control = experiment.controller
    optimizer = getattr(getattr(control, "optimizer", None), "type", None)
    shapes = sorted({obstacle.type for obstacle in experiment.obstacles})
    kinds = (control.type, optimizer, getattr(control, "motion", None), *shapes)
    return ", ".join(kind for kind in kinds if kind)
