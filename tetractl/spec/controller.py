"""Base classes of the sections of controllers and optimisers.

Each section is in the file of the class that it configures, and named in
`tetractl.core.registries`.
"""

import time
from abc import abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
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
        """Maximum number of iterations of a search, or of each start if it has several."""

    @property
    @abstractmethod
    def evaluations_min(self) -> int:
        """Minimum number of cost evaluations that a search needs."""

    @property
    def evaluations_max(self) -> int | None:
        """Maximum number of cost evaluations of a search without `Limits`. None if unknown."""
        return None

    @property
    def good_enough(self) -> float | None:
        """Cost J that is low enough to end a search.

        None if a search never ends because of its cost.
        """
        return None

    @abstractmethod
    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Search for the best sequence of signals; see `tetractl.core.protocols.Optimizer`.

        Args:
            problem: The planning problem.
            length: Number of signals in the sequence.
            warm: Warm start: a sequence to start from [rad], shape (length,). None if there is
                none.
            key: Key that determines all random numbers of the search.
            limits: Limits at which the search has to end early.
        """


@dataclass(frozen=True, slots=True)
class Host:
    """The services of the program that runs a controller.

    With another host, the same controller can be run again to verify a log.

    Attributes:
        wrap: Function through which the controller passes each of its optimisers.
        timer: Function that returns the time [ns]: the only clock that the controller reads.
    """

    wrap: Callable[[OptimizerSection], Optimizer] = lambda optimizer: optimizer
    timer: Callable[[], int] = time.perf_counter_ns


ALONE = Host()
"""The default host, which neither counts nor repeats a controller's searches."""


@dataclass(frozen=True, slots=True)
class NamedFile:
    """A file that the controller in a spec refers to, such as the weights of a learnt one.

    The contents of the file replace its name in the spec.

    Attributes:
        field: The field that names the file, such as `weights`.
        contents: The field that receives the contents of the file, such as `layers`.
        read: Function that reads the file. It returns the value of the field `contents`, and the
            text of the file, which the log keeps. Raises InvalidSpecError if the file is wrong.
    """

    field: str
    contents: str
    read: Callable[[Path], tuple[Any, str]]


class ControllerSection(Model):
    """A controller's parameters, with methods to check, build and describe the controller."""

    type: Any  # the section's name, a Literal in each subclass
    period: float = Field(default=0.2, ge=1e-3, allow_inf_nan=False)
    """Control period T [s] (the paper's experiment: 5 Hz)."""
    dead_time: float = Field(default=0.0, ge=0, le=10, allow_inf_nan=False)
    """Time from measurement to actuation that the controller assumes [s].

    Plans start at the poses that the robots will reach in that time with the directions already
    sent.
    """
    time_limit: float = Field(default=160.0, gt=0, le=1e6, allow_inf_nan=False)
    """Time after the first command at which a trial ends [s].

    It includes turns, pauses and the hold at the targets.
    """
    arrival_tolerance: NonNegative = 0.0
    """The robots have arrived when each is within this distance of its target [length unit].

    With 0, no trial ends early for this reason.
    """

    switches_field: ClassVar[bool] = False
    """Whether the controller ever switches the field off, which not every plant supports."""
    tours: ClassVar[bool] = False
    """Whether the controller supports way-points and a hold at the targets."""
    model_monitor: ClassVar[str] = "tetractl.run.model_changes:model_monitor"
    """The function that makes the monitor of the estimates in the plans, as "module:function".

    It is called with the experiment. Empty if the plans contain no estimates.
    """
    named_file: ClassVar[NamedFile | None] = None
    """The file that the section can name; None if it names no file."""

    @property
    def iterations_max(self) -> int:
        """Maximum number of iterations of one search. 0 if the controller does not search."""
        return 0

    @property
    def body_radius(self) -> float:
        """Radius of every robot's body [length unit]. 0 if the spec gives none."""
        return 0.0

    def fitted(self, stands: bool, speed: float) -> Self:
        """Return this section with the defaults that depend on the robots.

        Args:
            stands: Whether the robots can stand still.
            speed: Sum of the robots' speeds [length unit/s].
        """
        return self

    def arrived(self, gaps: Floats) -> bool:
        """Check whether all robots, at distances `gaps` (N,) from their targets, have arrived.

        All controllers and scripts use this method.
        """
        return self.arrival_tolerance > 0 and bool((gaps <= self.arrival_tolerance).all())

    def bounds(self) -> dict[str, str]:
        """Describe further limits of a trial for display, as {name: text}.

        By default, there are none.
        """
        return {}

    def numbers_held(self, setup: Setup) -> int:
        """Estimate the maximum number of 8-byte numbers that a control step stores.

        The default is 0, which means that the controller needs no check of its memory.
        """
        return 0

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield each field that contradicts the rest of the experiment, with a message.

        Locations are relative to this section. By default, there are no contradictions.
        """
        yield from ()

    @abstractmethod
    def build(self, setup: Setup, key: int, host: Host = ALONE) -> Controller:
        """Create the controller of one trial from this section of the spec.

        Args:
            setup: The constants of the experiment.
            key: Seed of all random numbers of the controller.
            host: The program that runs the controller.
        """

    def warm_up(self, setup: Setup) -> None:
        """Compile the functions that the controller needs, or load them from the cache.

        By default, there is nothing to compile.
        """
