"""Compile the functions that the controller of a spec needs, before a trial starts."""

import gc
import time
from collections.abc import Callable

from tetractl.spec.experiment import Experiment, find_packages
from tetractl.spec.section_abilities import Modelled, Searches
from tetractl.tools.cache import compile_listeners
from tetractl.tools.plugin_fault import name_plugins_in_errors

REMINDER_S = 10.0
"""Time between two messages that code is still being compiled [s]."""


def warm_up(experiment: Experiment, announce: Callable[[str], None]) -> None:
    """Compile the functions that the spec's controller runs, or load them from the cache.

    If anything is compiled, `announce` is called with a message at the beginning, every REMINDER_S
    seconds, and at the end. Compiled code is cached on disk, for all specs with the same kinds of
    controller, optimiser and motion. Python's garbage collection is off meanwhile, because the
    compiler creates so many objects that searching them would take a fifth of its time.
    """
    collects = gc.isenabled()
    start_s = time.monotonic()
    announced_s = list[float]()

    def announce_compiling() -> None:
        now_s = time.monotonic()
        if announced_s and now_s - announced_s[-1] < REMINDER_S:
            return
        duration = (
            "this takes about a minute, longer if the computer is busy; later runs "
            "reuse the compiled code"
        )
        if announced_s:
            duration = f"{now_s - start_s:.0f} s so far"
        announce(f"compiling for {compiled_for(experiment)}: {duration} ...")
        announced_s.append(now_s)

    compile_listeners.append(announce_compiling)
    gc.disable()
    try:
        with name_plugins_in_errors(find_packages(experiment)):
            experiment.controller.warm_up(experiment.setup)
    finally:
        compile_listeners.remove(announce_compiling)
        if collects:
            gc.enable()
    if announced_s:
        announce(f"compiled in {time.monotonic() - start_s:.0f} s")


def compiled_for(experiment: Experiment) -> str:
    """Return what a spec's code is compiled for, such as "mpc, pso, exact".

    These are the kinds of controller, optimiser and motion; a controller may have only the first.
    """
    control = experiment.controller
    kinds = [control.type]
    kinds += [control.optimizer.type] if isinstance(control, Searches) else []
    kinds += [control.motion] if isinstance(control, Modelled) else []
    return ", ".join(kinds)
