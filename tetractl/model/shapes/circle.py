"""Circular obstacles."""

from typing import Literal

import numpy as np

from tetractl.core.shape import Shape
from tetractl.experiment.base import Point, Positive
from tetractl.experiment.experiment import ShapeSection


class Circle(ShapeSection):
    """A round obstacle."""

    type: Literal["circle"]
    center: Point
    """Centre [x, y]."""
    radius: Positive
    """Radius [length unit]."""

    def shape(self) -> Shape:
        """Return the centre with the radius."""
        return Shape(np.array([self.center], dtype=np.float64), self.radius)
