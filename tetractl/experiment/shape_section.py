"""Base class of the sections of obstacle shapes; the shapes are in `tetractl.model.shapes`."""

from abc import abstractmethod
from typing import Any, ClassVar, Self

from pydantic import PrivateAttr

from tetractl.core.poses import Bools, Floats
from tetractl.experiment.base import Model


class ShapeSection(Model):
    """The section of an obstacle; its methods are documented at `tetractl.core.setup.Shape`."""

    type: Any  # the section's name, a Literal in each subclass
    packed: ClassVar[Any]
    """The `PackedShapes` class that holds these shapes for compiled code."""
    _margin: float = PrivateAttr(default=0.0)

    @property
    def margin(self) -> float:
        """Distance by which the shape is grown on every side [length unit]; at least 0."""
        return self._margin

    def grown(self, margin: float) -> Self:
        """Return the shape grown by a further margin [length unit]."""
        copy = self.model_copy()
        copy._margin = self._margin + margin
        return copy

    @abstractmethod
    def contain(self, x: Floats, y: Floats) -> Bools:
        """Return whether each point lies in the shape, p(s) of the paper's equation (13)."""

    @abstractmethod
    def cross(self, x0: Floats, y0: Floats, x1: Floats, y1: Floats) -> Bools:
        """Return whether each straight segment from (x0, y0) to (x1, y1) touches the shape."""

    @abstractmethod
    def distance(self, x: Floats, y: Floats) -> Floats:
        """Return the signed distance of each point to the edge, negative inside."""

    @abstractmethod
    def outline(self) -> Floats:
        """Return the corners of a closed polygon that draws the shape, (M, 2), anticlockwise."""

    @abstractmethod
    def row(self) -> tuple[float, ...]:
        """Return the shape's parameters as a row for `packed`."""
