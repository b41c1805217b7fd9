"""Base class of the sections of obstacle shapes; the shapes are in `tetractl.model.shapes`."""

from abc import abstractmethod
from typing import Any

from tetractl.core.shape import Shape
from tetractl.experiment.base import Model


class ShapeSection(Model):
    """The section of an obstacle."""

    type: Any  # the section's name, a Literal in each subclass

    @abstractmethod
    def shape(self) -> Shape:
        """Return the obstacle's corners and radius."""
