"""What a controller decides: searches, the plan chosen among them, or the end of the trial."""

from dataclasses import dataclass
from enum import StrEnum

from tetractl.core.poses import Floats


class Outcome(StrEnum):
    """How a trial ended; the first three are decided by the controller."""

    ARRIVED = "arrived"  # every robot within the arrival tolerance
    SEQUENCE_USED_UP = "sequence used up"  # no signal left in the warm start
    STEPS_MAX = "steps max"  # k_max control steps done
    INTERRUPTED = "interrupted"  # Ctrl-C or SIGTERM
    ABORTED = "aborted"  # a fault or an error; the reason says which

    @property
    def complete(self) -> bool:
        """Whether the trial ran to its own end, so that its error counts."""
        return self not in (Outcome.INTERRUPTED, Outcome.ABORTED)


@dataclass(frozen=True, slots=True)
class Search:
    """One search of the optimiser: one horizon in one control step.

    `length` counts signals; the paper's horizon is h = length - 1. `history[z]` is J(u_gb) after
    iteration z, entry 0 before the first (Figure 3). `stopped` says why it ended: "criterion",
    "iterations", "target", "evaluations" or "deadline".
    """

    length: int
    signals: Floats  # (length,) rad
    cost: float  # J, (7)
    history: Floats  # (iterations + 1,)
    evaluations: int
    stopped: str


@dataclass(frozen=True, slots=True)
class Plan:
    """The decision of one control step: the sequence chosen and how it was found.

    cost = target_cost + obstacle_weight * obstacle_cost, (7). `path` holds the predicted poses
    (length + 1, N, 3), the observed ones first. `searches` are all horizons tried, in order;
    `chosen` indexes the best. `generator` is the key all random draws of this step came from.
    """

    signals: Floats
    path: Floats
    cost: float
    target_cost: float
    obstacle_cost: float
    searches: tuple[Search, ...]
    chosen: int
    generator: int

    @property
    def search(self) -> Search:
        """The search that found the chosen sequence."""
        return self.searches[self.chosen]

    @property
    def evaluations(self) -> int:
        """Cost evaluations of the whole control step."""
        return sum(search.evaluations for search in self.searches)
