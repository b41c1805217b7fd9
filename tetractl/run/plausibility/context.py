"""What a check of plausibility is given, and what it yields."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from tetractl.core.setup import Setup
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.yaml.problems import Loc
from tetractl.model import bounds


@dataclass(frozen=True, slots=True)
class SpecWarning:
    """What a check found: where in the spec, what with its number, and what would help."""

    loc: Loc
    message: str
    hint: str


@dataclass(frozen=True)
class CheckContext:
    """An experiment, with what the checks need of its controller.

    A controller of another kind may lack some of it: `signals_max` is None where no plan has a
    longest length, `motion` is "" where none is named.
    """

    experiment: Experiment
    setup: Setup
    signal_s: float  # for how long one signal of a plan is held
    signals_max: int | None
    motion: str
    margin: float  # kept from obstacles, with the radius of a robot
    yields: bool  # whether the margin shrinks at starts and targets
    walls: bool
    tolerance: float

    @classmethod
    def of(cls, experiment: Experiment) -> "CheckContext":
        """Return what the checks need of an experiment."""
        control: Any = experiment.controller
        collision = getattr(control, "collision", None)
        return cls(
            experiment=experiment,
            setup=experiment.setup,
            signal_s=getattr(control, "hold", 1) * control.period,
            signals_max=getattr(control, "horizon_max", None),
            motion=getattr(control, "motion", ""),
            margin=collision.margin + collision.radius if collision else 0.0,
            yields=collision.adaptive if collision else False,
            walls=collision.walls if collision else False,
            tolerance=control.arrival_tolerance,
        )

    @property
    def unit(self) -> str:
        """The length unit."""
        return self.setup.unit

    @property
    def longest_s(self) -> float:
        """How long robots move in a trial at most."""
        return (self.setup.steps_max + 1) * self.setup.period_s

    @cached_property
    def least_total_error(self) -> float:
        """A lower bound of the total error of any plan [length unit], see `model.bounds`."""
        return bounds.least_total_error(self.setup, self.longest_s)
