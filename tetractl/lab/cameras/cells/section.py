"""The `cells` camera's part of a spec: a microscope's pictures, and where they are in the dish."""

import math
from collections.abc import Callable
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from tetractl.core.clock import Clock
from tetractl.core.errors import AbortError
from tetractl.core.protocols import Camera
from tetractl.core.setup import Setup
from tetractl.experiment.base import Finite, NonNegative, Point, Positive
from tetractl.experiment.lab_section import CameraSection
from tetractl.lab.cameras.apriltag.section import Source, named


class CellsSection(CameraSection):
    """A microscope that looks at swimming cells; those nearest to the starts are the robots."""

    device: ClassVar[str] = "tetractl.lab.cameras.cells.camera:CellCamera"
    type: Literal["cells"]
    source: Source
    """Where pictures come from."""
    um_px: Annotated[float, Field(ge=0.05, le=100)]
    """Micrometres a pixel, by a stage micrometer."""
    corner: Point = (0.0, 0.0)
    """Where the picture's lower left corner is in the spec's coordinates [length unit]."""
    rotation: Finite = 0.0
    """From the spec's x axis to the picture's rows, anticlockwise [rad]."""
    cells: Literal["dark", "bright", "either"] = "either"
    """What cells are against the medium; by default it is found out."""
    learning: Annotated[float, Field(ge=0.5, le=30)] = 1.5
    """How long pictures are taken for the background before the first frame [s]."""
    latency: NonNegative = 0.05
    """From exposure to arrival of a picture [s]; no source reports it."""
    connect: Positive = 8.0
    """How long the source may take to open, and then to deliver and show the background [s]."""

    @property
    def source_name(self) -> str:
        """Name of the source, for people."""
        return named(self.source)

    @property
    def bright(self) -> bool | None:
        """Whether cells are brighter than the medium; None where that is to be found out."""
        return None if self.cells == "either" else self.cells == "bright"

    def bounds(self) -> dict[str, str]:
        """Return where pictures come from."""
        return {"camera": f"{self.source_name}, {self.um_px:g} um/px"}

    def build(self, setup: Setup, clock: Clock, wake: Callable[[], None]) -> Camera:
        """Return the camera of the setup's robots; AbortError without OpenCV."""
        try:
            return super().build(setup, clock, wake)
        except ModuleNotFoundError as error:
            if error.name != "cv2":
                raise
            raise AbortError(
                "the cells camera needs OpenCV, which is not installed",
                "pip install 'tetractl[vision]'",
            ) from error

    def placed(self, x_um: float, y_um: float, metres: float) -> tuple[float, float]:
        """Return a place of the picture [um] in the spec's coordinates, `metres` a unit."""
        cos, sin = math.cos(self.rotation), math.sin(self.rotation)
        scale = 1e-6 / metres
        x = self.corner[0] + scale * (cos * x_um - sin * y_um)
        return x, self.corner[1] + scale * (sin * x_um + cos * y_um)
