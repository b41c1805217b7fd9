"""The section of a spec by which each trial finds its robots: `robots: {choose: N, ...}`."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import Field, GetCoreSchemaHandler, GetJsonSchemaHandler, model_validator
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from tetractl.core.poses import Floats, Pose
from tetractl.core.protocols import Plant
from tetractl.core.setup import Setup
from tetractl.experiment.base import Model, Point, Positive, inconsistent

RESPONDS = 3.5  # standard deviations of a above 0: one cell of 4000 is there by chance


class Ring(Model):
    """Targets spread evenly on a circle, one for each robot."""

    center: Point
    """Centre of the circle [length unit]."""
    radius: Positive
    """Radius of the circle [length unit]."""

    def points(self, count: int) -> tuple[tuple[float, float], ...]:
        """Return the given number of targets on the circle."""
        angles = 2 * np.pi * np.arange(count) / count
        x, y = self.center
        return tuple(
            (x + self.radius * float(np.cos(one)), y + self.radius * float(np.sin(one)))
            for one in angles
        )


class WantedCell(Model):
    """A cell that a survey proposed; the trial finds the cell again by these values."""

    a: Positive
    """Turning rate a of the cell [rad/s]."""
    speed: Positive
    """Speed of the cell [length unit/s]."""


class Choice(Model):
    """Robots that the trial finds at their present poses. In the lab the field rotates for
    `seconds`, and the camera measures each cell's response; the robots are the cells whose turning
    rates a differ most, or the `wanted` cells. In a simulation the cells are drawn at random.
    """

    choose: int = Field(ge=1, le=20)
    """Number of robots to choose."""
    targets: tuple[Point, ...] = Field(default=(), max_length=1000)
    """Targets [x, y] [length unit], at least as many as robots. Targets are assigned so that the
    sum of the squared distances from start to target is least.
    """
    ring: Ring | None = None
    """Targets on a circle, in place of `targets`."""
    a: Positive
    """Typical turning rate a of the cells [rad/s]."""
    speed: Positive
    """Typical speed of the cells [length unit/s]."""
    wanted: tuple[WantedCell, ...] = Field(default=(), max_length=20)
    """The cells that a survey proposed, as many as there are robots."""
    seconds: Positive = Field(default=8.0, le=600)
    """Time for which the field rotates before the cells are chosen [s]."""
    turn: Positive = Field(default=3.2, le=60)
    """Duration of one turn of the field [s]; cells with a turning rate a below 2 pi / `turn` lag
    behind."""

    found: bool = False
    """Whether a trial has found its robots; the trial sets this in the spec that it logs."""

    @model_validator(mode="after")
    def _fits(self) -> "Choice":
        if (self.ring is None) == (not self.targets):
            raise inconsistent("targets", "give either targets or a ring")
        if self.targets and len(self.targets) < self.choose:
            raise inconsistent("targets", f"must be at least {self.choose}, one for each robot")
        if self.wanted and len(self.wanted) != self.choose:
            raise inconsistent("wanted", f"must be {self.choose}, one for each robot")
        return self

    @property
    def goals(self) -> Floats:
        """The targets (M, 2), at least as many as robots."""
        points = self.targets if self.ring is None else self.ring.points(self.choose)
        return np.array(points, dtype=np.float64)


class OrMapping:
    """Annotation of a field of another type whose value may be a mapping, which is read as a
    `model`: `robots` may be a `Choice`, and `plain` is what the value is otherwise."""

    def __init__(self, model: type[Model], plain: Any = None) -> None:
        self.model, self.plain = model, plain

    def __get_pydantic_core_schema__(
        self, source: type[Any], handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        def validate(value: Any, listed: Any, info: core_schema.ValidationInfo) -> Any:
            if not isinstance(value, dict | self.model):
                return listed(value)
            strict = bool(info.context and info.context.get("strict"))
            return self.model.model_validate(value, strict=strict, context=info.context)

        otherwise = handler.generate_schema(self.plain) if self.plain else handler(source)
        either = core_schema.wrap_serializer_function_ser_schema(
            lambda value, inner: inner(value), schema=handler(source)
        )
        return core_schema.with_info_wrap_validator_function(
            validate, otherwise, serialization=either
        )

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        return {"anyOf": [handler(schema), handler(self.model.__pydantic_core_schema__)]}


@dataclass(frozen=True, slots=True)
class RobotCandidate:
    """A cell of the dish: its number, its pose in the spec's unit, and its response to the field.

    `a` [rad/s] is known with a standard deviation `a_sd`, `speed` [length unit/s] with `speed_sd`.
    A cell that was near the arena's edge is not `free`, as a wall may have turned it.
    """

    number: int
    pose: Pose
    a: float
    a_sd: float
    speed: float
    speed_sd: float
    free: bool = True

    @property
    def magnetised(self) -> bool:
        """Whether the cell responds to the field: its a and its speed exceed 0 by RESPONDS standard
        deviations. What does not swim, such as a speck, has an axis that noise may turn."""
        return self.a > RESPONDS * self.a_sd and self.speed > RESPONDS * self.speed_sd


@dataclass(frozen=True, slots=True)
class FoundRobots:
    """The candidates that a plant found: `build(numbers, setup)` returns a plant of those with the
    given numbers, `close()` releases the devices.
    """

    candidates: Sequence[RobotCandidate]
    build: Callable[[Sequence[int], Setup], Plant]
    close: Callable[[], None]


def dealt(starts: Floats, targets: Floats) -> list[int]:
    """Return the index (N,) of the target that each start gets: starts (N, 2), targets (M, 2).

    M must be at least N. The sum of the squared distances from start to target is minimal, which
    minimises the motion that is not common to all robots.
    """
    from scipy.optimize import linear_sum_assignment  # slow to import, and seldom needed

    squares = np.square(starts[:, None] - targets).sum(axis=2)
    return linear_sum_assignment(squares)[1].tolist()
