"""The sweep of a study: a list of points, each of which sets some fields of a spec.

`type: grid` gives every combination of listed values, `list` gives listed points, and `random` and
`sobol` give points sampled from ranges.
"""

import itertools
import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from tetractl.core.poses import Floats
from tetractl.spec.base import Finite, Model, inconsistent
from tetractl.spec.yaml.problems import Loc

FieldPath = Annotated[str, Field(min_length=1, max_length=200)]
"""The path of a field of a spec, as in `--set`, such as `controller.optimizer.rounds`."""


@dataclass(frozen=True, slots=True)
class Setting:
    """A value for a field of the spec, with its location in the file of the study."""

    value: Any
    loc: Loc


class Sweep(Model):
    """The part `sweep` of a study: which fields of the spec vary, and over which values.

    Each kind of sweep has its own name as the `Literal` of its `type`.
    """

    @abstractmethod
    def draw(self, rng: np.random.Generator) -> list[Mapping[str, Setting]]:
        """Return the points of the sweep, each a mapping of field paths to settings.

        Args:
            rng: Random numbers with the study's seed. Only random sweeps use them.
        """


Values = Annotated[tuple[Any, ...], Field(min_length=1, max_length=1000)]


class Grid(Sweep):
    """A sweep with every combination of the listed values. The last field changes fastest."""

    type: Literal["grid"]
    fields: dict[FieldPath, Values] = Field(min_length=1)
    """Values of each swept field, by path, such as `plant.dead_time`."""

    def draw(self, rng: np.random.Generator) -> list[Mapping[str, Setting]]:
        """Return every combination of the values that the fields take."""
        axes: list[list[Setting]] = []
        for path, values in self.fields.items():
            axes.append([Setting(value, ("fields", path, i)) for i, value in enumerate(values)])
        return [dict(zip(self.fields, point, strict=True)) for point in itertools.product(*axes)]


Point = Annotated[dict[FieldPath, Any], Field(min_length=1)]


class Points(Sweep):
    """A sweep that lists its points, each of which sets some fields of the base spec.

    A field that a point does not set has the value of the base spec.
    """

    type: Literal["list"]
    points: tuple[Point, ...] = Field(min_length=1, max_length=100_000)
    """The points, each a mapping of paths, such as `plant.dead_time`, to values."""

    def draw(self, rng: np.random.Generator) -> list[Mapping[str, Setting]]:
        """Return the combinations of values in the order in which the study lists them.

        `rng` is unused, because nothing is random here.
        """
        points: list[Mapping[str, Setting]] = []
        for i, point in enumerate(self.points):
            settings = {path: Setting(value, ("points", i, path)) for path, value in point.items()}
            points.append(settings)
        return points


class Range(Model):
    """The range from which values of a field are sampled."""

    low: Finite
    """Lower end of the range."""
    high: Finite
    """Upper end of the range."""
    scale: Literal["linear", "log"] = "linear"
    """`linear` spreads values evenly over the range, `log` spreads their logarithms evenly."""
    whole: bool = False
    """Whether only whole numbers are sampled, both ends included."""

    @model_validator(mode="after")
    def _rises(self) -> Self:
        if self.high <= self.low:
            raise inconsistent("high", "must be greater than the field low")
        if self.scale == "log" and self.low <= 0:
            raise inconsistent("low", "must be greater than 0 on a logarithmic scale")
        fractional = self.low % 1 != 0 or self.high % 1 != 0
        if self.whole and fractional:
            raise inconsistent("whole", "needs whole numbers in the fields low and high")
        return self

    def at(self, fraction: float) -> float:
        """Return the field's value at a fraction of the range, from 0 to below 1.

        Rounding never takes the value beyond `low` or `high`. If `whole` is set, each
        whole number takes an equal part of the fractions on a linear scale.
        """
        if self.whole:
            # as many values round down to the highest number as to any other
            value = self._interpolate(self.low, self.high + 1, fraction)
            return math.floor(min(max(value, self.low), self.high + 0.5))
        value = self._interpolate(self.low, self.high, fraction)
        return min(max(value, self.low), self.high)

    def _interpolate(self, low: float, high: float, fraction: float) -> float:
        """Interpolate between two values of a field; rounding may exceed them slightly."""
        if self.scale == "log":
            log_low = math.log(low)
            return math.exp(log_low + fraction * (math.log(high) - log_low))
        return low + fraction * (high - low)


class SampledSweep(Sweep):
    """A sweep whose points are sampled at random from the ranges of some fields.

    The study's seed determines the points.
    """

    count: int = Field(ge=1, le=100_000)
    """Number of points. A larger number keeps the points sampled before and adds new ones."""
    fields: dict[FieldPath, Range] = Field(min_length=1, max_length=1000)
    """Range of each swept field, by path, such as `plant.dead_time`."""

    @abstractmethod
    def shares(self, rng: np.random.Generator) -> Floats:
        """Return numbers from 0 to below 1, shape (count, number of fields)."""

    def draw(self, rng: np.random.Generator) -> list[Mapping[str, Setting]]:
        """Return `count` random combinations of values from the ranges of the fields."""
        return [self._point(fractions) for fractions in self.shares(rng).tolist()]

    def _point(self, fractions: Sequence[float]) -> Mapping[str, Setting]:
        """Return the settings at one point, given as a fraction of each field's range."""
        settings: dict[str, Setting] = {}
        for (path, range_), fraction in zip(self.fields.items(), fractions, strict=True):
            settings[path] = Setting(range_.at(fraction), ("fields", path))
        return settings


class Random(SampledSweep):
    """A sweep whose points, combinations of values, are sampled independently of one another."""

    type: Literal["random"]

    def shares(self, rng: np.random.Generator) -> Floats:
        """Return independent uniform numbers from 0 to below 1, shape (count, number of fields)."""
        return rng.random((self.count, len(self.fields)))


class Sobol(SampledSweep):
    """A sweep with the points of a scrambled Sobol sequence.

    They fill the ranges more evenly than random points.

    They do so best if their number is a power of 2.
    """

    type: Literal["sobol"]

    def shares(self, rng: np.random.Generator) -> Floats:
        """Return the first `count` points of a Sobol sequence that `rng` scrambles.

        The numbers range from 0 to below 1, and the shape is (count, number of fields).
        See Owen, J. Complexity 14, 1998.
        """
        from scipy.stats import qmc  # slow to import, and only needed here

        sequence = qmc.Sobol(len(self.fields), rng=rng)
        log2_count = math.ceil(math.log2(self.count))
        return sequence.random_base2(log2_count)[: self.count]
