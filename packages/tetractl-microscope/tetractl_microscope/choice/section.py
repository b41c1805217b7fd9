"""The section of a spec whose trials choose their robots: `robots: {choose: N, ...}`."""

from collections.abc import Sequence
from typing import ClassVar, Self

import numpy as np
from pydantic import Field, model_validator

from tetractl.core.poses import Floats
from tetractl.spec.base import Model, Point, Positive, inconsistent
from tetractl.spec.experiment import Experiment
from tetractl.spec.trial_robots import StandIn, TrialRobots


class Ring(Model):
    """Targets spread evenly on a circle, one for each robot."""

    center: Point
    """Centre of the circle [length unit]."""
    radius: Positive
    """Radius of the circle [length unit]."""

    def points(self, count: int) -> tuple[tuple[float, float], ...]:
        """Return `count` targets x, y [length unit], evenly spaced on the circle.

        The first one is to the right of the centre, and the others follow anticlockwise.
        """
        angles = 2 * np.pi * np.arange(count) / count
        x, y = self.center
        points: list[tuple[float, float]] = []
        for angle in angles:
            right = self.radius * float(np.cos(angle))
            up = self.radius * float(np.sin(angle))
            points.append((x + right, y + up))
        return tuple(points)


class WantedCell(Model):
    """A cell that a survey proposed. The trial finds the cell again by these values."""

    a: Positive
    """Turning rate a of the cell [rad/s]."""
    speed: Positive
    """Speed of the cell [length unit/s]."""


class Choice(TrialRobots):
    """Robots that each trial chooses among the cells of a dish.

    In the lab, the field rotates for `seconds`, and the camera measures each cell's response. The
    robots are then the cells with the most different turning rates a, or the `wanted` cells. In a
    simulation, the cells are generated at random.
    """

    key: ClassVar[str] = "choose"
    prepare: ClassVar[str] = "tetractl_microscope.choice.prepare:prepare"

    choose: int = Field(ge=1, le=20)
    """Number of robots to choose."""
    targets: tuple[Point, ...] = Field(default=(), max_length=1000)
    """Targets [x, y] [length unit], at least as many as robots.

    They are assigned so that the sum of the squared distances from start to target is minimal.
    """
    ring: Ring | None = None
    """Targets on a circle, instead of `targets`."""
    a: Positive
    """Typical turning rate a of the cells [rad/s]."""
    speed: Positive
    """Typical speed of the cells [length unit/s]."""
    wanted: tuple[WantedCell, ...] = Field(default=(), max_length=20)
    """The cells that a survey proposed, as many as there are robots.

    If empty, the trial chooses.
    """
    seconds: Positive = Field(default=8.0, le=600)
    """Time for which the field rotates before the cells are chosen [s]."""
    turn: Positive = Field(default=3.2, le=60)
    """Duration of one turn of the field [s].

    Cells with a turning rate a below 2 pi / `turn` lag behind.
    """

    found: bool = False
    """Whether a trial has found its robots. The trial sets this field in the spec that it logs."""

    @model_validator(mode="after")
    def _fits(self) -> "Choice":
        if (self.ring is None) == (not self.targets):
            raise inconsistent("targets", "give either targets or a ring, and only one of them")
        if self.targets and len(self.targets) < self.choose:
            raise inconsistent(
                "targets", f"must be at least {self.choose}, so that there is one for each robot"
            )
        if self.wanted and len(self.wanted) != self.choose:
            raise inconsistent("wanted", f"must have {self.choose} entries, one for each robot")
        return self

    @property
    def goals(self) -> Floats:
        """The targets, shape (M, 2) [length unit]. There are at least as many as robots."""
        points = self.targets if self.ring is None else self.ring.points(self.choose)
        return np.array(points, dtype=np.float64)

    @property
    def are_found(self) -> bool:
        """Whether a trial has already chosen its robots among the cells in the dish."""
        return self.found

    def sought(self) -> Self:
        """Return a copy without the robots that a trial has found, as in the original spec."""
        return self.model_copy(update={"found": False})

    @property
    def stand_ins(self) -> Sequence[StandIn]:
        """Placeholder robots until cells are chosen: typical cells at the first targets."""
        goals = enumerate(self.goals[: self.choose].tolist(), 1)
        return [StandIn(f"cell {i}", (x, y), self.a, self.speed) for i, (x, y) in goals]


def require_choice(experiment: Experiment) -> Choice:
    """Return the rule by which an experiment's trials choose their robots.

    It is an `AssertionError` if the spec's robots are given instead.
    """
    assert isinstance(experiment.chosen, Choice), (
        "the spec must say which robots to choose, with robots: {choose: N}"
    )
    return experiment.chosen
