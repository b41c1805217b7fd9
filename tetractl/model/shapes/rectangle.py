"""Axis-aligned rectangles."""

from typing import Literal

import numpy as np

from tetractl.core.shape import Shape
from tetractl.experiment.base import Finite, Positive
from tetractl.experiment.experiment import ShapeSection


class Rectangle(ShapeSection):
    """An axis-aligned rectangle, defined as in the paper by left, bottom, width and height."""

    type: Literal["rectangle"]
    left: Finite
    """Least x [length unit]."""
    bottom: Finite
    """Least y [length unit]."""
    width: Positive
    """Extent in x [length unit]."""
    height: Positive
    """Extent in y [length unit]."""

    def shape(self) -> Shape:
        """Return the four corners."""
        right = self.left + self.width
        top = self.bottom + self.height
        corners = [(self.left, self.bottom), (right, self.bottom), (right, top), (self.left, top)]
        return Shape(np.array(corners))
