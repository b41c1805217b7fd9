"""`sweep: {type: list}`: points written one by one."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from tetractl.study.sweep import Path, Setting, Sweep

Point = Annotated[dict[Path, Any], Field(min_length=1)]


class Points(Sweep):
    """The points listed; fields that a point leaves out keep the value of the base."""

    type: Literal["list"]
    points: tuple[Point, ...] = Field(min_length=1, max_length=100_000)
    """Each a mapping of paths, such as `plant.dead_time`, to values."""

    def draw(self, rng: np.random.Generator) -> list[Mapping[str, Setting]]:
        """Return the points in their order."""
        return [
            {path: Setting(value, ("points", i, path)) for path, value in point.items()}
            for i, point in enumerate(self.points)
        ]
