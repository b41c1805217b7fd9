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
from tetractl.experiment.base import Model, NonNegative
from tetractl.experiment.yaml.problems import Loc


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


_PERIOD_S = {"mpc": 0.05}
_OTHER_PERIOD_S = 0.2
"""The control period of a spec that gives none [s]."""


def earlier_limit(controller: Any) -> float | None:
    """Return the `time_limit` [s] that ends a trial when `steps_max` did, by the keys of a
    controller; None if they do not give it. The controller `pso-mpc` counts steps, as published."""
    if not isinstance(controller, dict) or controller.get("type") == "pso-mpc":
        return None
    steps = controller.get("steps_max")
    period_s = controller.get("period")
    if period_s is None:
        period_s = _PERIOD_S.get(str(controller.get("type")), _OTHER_PERIOD_S)
    if isinstance(steps, int) and isinstance(period_s, int | float):
        return float(f"{(steps + 1) * period_s:.9g}")
    return None


def retired_hint(key: str, section: Any) -> str | None:
    """Return what to write for a retired key of a section, None for any other key."""
    if key == "intensity":
        return "a controller chooses a direction only; write strength: [mT], and a: {per_mT: ...}"
    if key == "first_plan":
        return "robots stand while the first plan is computed; leave it out"
    if key == "silence":
        return "plans are no longer asked what a silence of the radio does; leave it out"
    limit = earlier_limit(section) if key == "steps_max" else None
    return None if limit is None else f"a trial's limit is a time now; write time_limit: {limit:g}"


def without_retired(data: dict[str, Any]) -> None:
    """Replace the retired keys in the spec of an earlier log: its limit was `steps_max`; while the
    first plan was computed its robots stood, unless `first_plan` said that they drive; and plans
    were asked what a `silence` of the radio does."""
    control = data.get("controller", {})
    if isinstance(control, dict) and control.get("first_plan") == {"type": "stand"}:
        del control["first_plan"]
    collision = control.get("collision") if isinstance(control, dict) else None
    if isinstance(collision, dict):
        collision.pop("silence", None)
    limit = earlier_limit(control)
    if limit is not None:
        del control["steps_max"]
        control["time_limit"] = limit


def with_logged_keys(fields: Any, logged: Any) -> Any:
    """Return the fields of a spec with the keys, also retired ones, of the spec `logged` in a log:
    a field that was added since is left out."""
    if isinstance(fields, dict) and isinstance(logged, dict):
        return {
            key: with_logged_keys(fields[key], value) if key in fields else value
            for key, value in logged.items()
        }
    both_lists = isinstance(fields, list) and isinstance(logged, list)
    if both_lists and len(fields) == len(logged):
        return [with_logged_keys(*pair) for pair in zip(fields, logged, strict=True)]
    return fields
