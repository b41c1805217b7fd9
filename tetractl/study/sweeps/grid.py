"""`sweep: {type: grid}`: every combination of some values."""

import itertools
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from tetractl.study.sweep import Path, Setting, Sweep

Values = Annotated[tuple[Any, ...], Field(min_length=1, max_length=1000)]


class Grid(Sweep):
    """Every combination of the values listed, the last field changing fastest."""

    type: Literal["grid"]
    fields: dict[Path, Values] = Field(min_length=1)
    """By path, such as `plant.dead_time`, the values that the field takes."""

    def draw(self, rng: np.random.Generator) -> list[Mapping[str, Setting]]:
        """Return every combination."""
        axes = [
            [Setting(value, ("fields", path, i)) for i, value in enumerate(values)]
            for path, values in self.fields.items()
        ]
        return [dict(zip(self.fields, point, strict=True)) for point in itertools.product(*axes)]
