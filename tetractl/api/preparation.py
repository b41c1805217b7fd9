"""Steps before and around simulations: checks, compiling, and signals such as Ctrl-C."""

import logging
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING

from tetractl.core.errors import UsageError
from tetractl.spec.loaded_spec import LoadedSpec

if TYPE_CHECKING:
    from tetractl.run.interrupt import Interrupt


def check_simulated(spec: LoadedSpec, announce: Callable[[str], None]) -> None:
    """Check that a spec can be simulated, log its warnings, and compile its kernels.

    `announce` is called with a line of text before anything is compiled.
    """
    from tetractl.control.methods.build import warm_up
    from tetractl.run.plausibility import find_warnings

    experiment = spec.experiment
    if experiment.plant.real_time:
        raise UsageError(
            "this function cannot drive robots in a lab, but the spec's plant is the lab",
            "use `tetractl run`",
        )
    for warning in find_warnings(spec):
        logging.getLogger("tetractl").warning("warning: %s", warning)
    warm_up(experiment, announce)


def announcer(progress: bool) -> Callable[[str], None]:
    """Return the function that announces compiling.

    The function prints to stderr if `progress` is True. Otherwise, it logs at level INFO.
    """
    if progress:
        return partial(print, file=sys.stderr, flush=True)
    return logging.getLogger("tetractl").info


@contextmanager
def interruptible(after: str = "") -> "Iterator[Interrupt]":
    """Count signals such as Ctrl-C during the `with` block, and raise KeyboardInterrupt after it.

    Nothing is raised if no signal arrived. `after` is the error's message, which says what can be
    done next.
    """
    from tetractl.run.interrupt import Interrupt

    interrupt = Interrupt()
    if threading.current_thread() is threading.main_thread():
        with interrupt.watch():
            yield interrupt
    else:  # only the main thread receives signals
        yield interrupt
    if interrupt.requested:
        raise KeyboardInterrupt(after) if after else KeyboardInterrupt
