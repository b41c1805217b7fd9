"""Whether a logged particle swarm search can have ended as its log says, by its history alone.

`tetractl verify` asks this of every search, also of those that it does not repeat. A history fixes
the number of evaluations. It fixes the reason for the end too, unless a limit cut the search short.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from tetractl.control.stop import reason_to_stop
from tetractl.core.plan import Limits, Search, StopReason
from tetractl.core.poses import Floats

if TYPE_CHECKING:  # it imports this module
    from tetractl.control.optimizers.pso import Pso


def contradictions(section: "Pso", logged: Search, warmed: bool, limits: Limits) -> Iterator[str]:
    """Yield "evaluations" if the logged number of evaluations contradicts the logged history,
    and "stopped" if the logged reason for the end contradicts that history.

    `warmed` is whether the search had a warm start, which is evaluated once. A search without a
    history is reported elsewhere.
    """
    if not len(logged.history):
        return
    scattered_and_moved = section.particles * len(logged.history)
    if logged.evaluations != (scattered_and_moved + 1 if warmed else scattered_and_moved):
        yield "evaluations"
    if logged.stopped not in _possible_ends(section, logged.history, limits):
        yield "stopped"


def _possible_ends(section: "Pso", history: Floats, limits: Limits) -> set[StopReason]:
    """Return the reasons for which a search with this history may have ended."""
    iterations = len(history) - 1
    if iterations > 0:
        with np.errstate(invalid="ignore"):  # logarithms fail if a logged history rises
            reason = reason_to_stop(history, section.stop)
        if reason is not None:
            return {reason}
    if iterations >= section.iterations:
        return {StopReason.ITERATIONS}
    cut_short = set[StopReason]()
    if limits.evaluations is not None:
        cut_short.add(StopReason.EVALUATIONS)
    if limits.timed:
        cut_short.add(StopReason.DEADLINE)
    return cut_short
