"""Base classes of the sections of controllers and optimisers.

Each section is in the file of the class that it configures, and named in
`tetractl.core.registries`.
"""

import time
from abc import abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, Self

from pydantic import Field

from tetractl.core.plan import Limits, Problem, Search
from tetractl.core.poses import Floats
from tetractl.core.protocols import Controller, Optimizer
from tetractl.core.setup import Setup
from tetractl.spec.base import Model, NonNegative
from tetractl.spec.yaml.problems import Loc


class OptimizerSection(Model):
    """An optimiser with its parameters; each subclass implements the protocol `Optimizer`.

    `search` must import compiled code only when it is called, because specs are checked without it.
    """

    type: Any  # the section's name, a Literal in each subclass

    @property
    @abstractmethod
    def iterations_max(self) -> int:
        """Largest number of iterations of a search; of each start if there are several."""

    @property
    @abstractmethod
    def evaluations_min(self) -> int:
        """Least number of cost evaluations that a search needs."""

    @property
    def evaluations_max(self) -> int | None:
        """Largest number of cost evaluations of a search without `Limits`, None if unknown."""
        return None

    @property
    def good_enough(self) -> float | None:
        """Cost J that is low enough to end a search, None if a lower cost is always better."""
        return None

    @abstractmethod
    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Search sequences of `length` signals; see `tetractl.core.protocols.Optimizer`."""


@dataclass(frozen=True, slots=True)
class Host:
    """What a controller uses of the program that runs it: `wrap`, through which it passes each
    optimiser, and `timer`, the only clock that it reads [ns]. So a log can be verified by repeating
    every search."""

    wrap: Callable[[OptimizerSection], Optimizer] = lambda optimizer: optimizer
    timer: Callable[[], int] = time.perf_counter_ns


ALONE = Host()
"""The host of a controller whose searches are neither counted nor repeated."""


class ControllerSection(Model):
    """A controller's parameters, and the methods by which tetractl checks, builds and describes
    it."""

    type: Any  # the section's name, a Literal in each subclass
    period: float = Field(default=0.2, ge=1e-3, allow_inf_nan=False)
    """Control period T [s] (the paper's experiment: 5 Hz)."""
    dead_time: float = Field(default=0.0, ge=0, le=10, allow_inf_nan=False)
    """Time from measurement to actuation that the controller assumes [s]: plans start where the
    robots will be after that time under the directions already sent.
    """
    time_limit: float = Field(default=160.0, gt=0, le=1e6, allow_inf_nan=False)
    """Time from the first command after which a trial ends [s], turns, rests and the hold at the
    targets included."""
    arrival_tolerance: NonNegative = 0.0
    """The robots have arrived when each is within this distance of its target [length unit]; with
    0, no trial ends early for this reason."""

    switches_field: ClassVar[bool] = False
    """Whether the controller ever switches the field off, which not every plant supports."""
    tours: ClassVar[bool] = False
    """Whether the controller supports way-points and a hold at the targets."""

    @property
    def iterations_max(self) -> int:
        """Largest number of iterations of one search, 0 if the controller does not search."""
        return 0

    @property
    def body_radius(self) -> float:
        """Radius of every robot's body [length unit], 0 if the spec gives none."""
        return 0.0

    def fitted(self, stands: bool, speed: float) -> Self:
        """Return the section with those defaults set that depend on the robots: whether they can
        stand still, and the sum of their speeds [length unit/s]."""
        return self

    def arrived(self, gaps: Floats) -> bool:
        """Return whether all robots, at distances `gaps` (N,) from their targets, have arrived.

        This is the one place where that is decided, for every controller and for scripts.
        """
        return self.arrival_tolerance > 0 and bool((gaps <= self.arrival_tolerance).all())

    def bounds(self) -> dict[str, str]:
        """Return further limits of a trial for display, {name: text}."""
        return {}

    def numbers_held(self, setup: Setup) -> int:
        """Return an estimate of how many 8-byte numbers a control step stores at most."""
        return 0

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield location (in this section) and text of each contradiction with the experiment."""
        yield from ()

    @abstractmethod
    def build(self, setup: Setup, key: int, host: Host = ALONE) -> Controller:
        """Return the controller of one trial; `key` seeds all its random numbers."""

    def warm_up(self, setup: Setup) -> None:
        """Compile the functions that the controller needs, or load them from the cache."""
