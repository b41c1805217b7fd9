"""The section of a spec for the `cells` camera: a microscope's images, their scale and position."""

import math
from typing import Annotated, ClassVar, Literal, TypeVar

from pydantic import Field

from tetractl.core.errors import UsageError
from tetractl.core.poses import Floats
from tetractl.spec.base import Angle, Point, Positive
from tetractl.spec.lab_section import Measured
from tetractl.spec.registry_fields import KindName
from tetractl_microscope.pictures.picture_section import PictureSection
from tetractl_microscope.registries import ORGANISMS

DISTANCE_MIN_PX = 50  # minimum distance between the two points of a scale measurement
POINT_SD_PX = 1.0  # standard deviation of each point's column and row

Lengths = TypeVar("Lengths", float, Floats)


class CellsSection(PictureSection):
    """A microscope's camera above swimming cells. The cells nearest to the starts become robots."""

    device: ClassVar[str] = "tetractl_microscope.cells.camera:CellCamera"
    settles: ClassVar[bool] = True
    type: Literal["cells"]
    um_px: Annotated[float, Field(ge=0.05, le=100)]
    """Micrometres per pixel, measured with a stage micrometer."""
    corner: Point = (0.0, 0.0)
    """Position of the image's lower left corner in the spec's coordinates [length unit]."""
    rotation: Angle = 0.0
    """Angle from the spec's x axis to the rows of the image, anticlockwise [rad]."""
    mirrored: bool = False
    """Whether images are mirrored left to right. They are mirrored back before `rotation`."""
    organism: Annotated[str, KindName(ORGANISMS)] = "tetrahymena"
    """Kind of cell in the dish. Its sizes and speeds decide which objects are cells."""
    learning: Annotated[float, Field(ge=0.5, le=30)] = 1.5
    """Time before the first frame in which images for the background are taken [s]."""
    connect: Positive = 8.0
    """Maximum wait for the source to open, and then for the first images and background [s]."""

    def bounds(self) -> dict[str, str]:
        """Describe the source and the scale of the images for display: {name: text}."""
        return {"camera": f"{self.source_name}, {self.um_px:g} um/px"}

    def measured_by(self, first: Point, second: Point, um: float) -> Measured:
        """Compute the scale and rotation of the image from two points at a known distance.

        Args:
            first: Column and row of the first point [px].
            second: Column and row of the second point [px]. It lies in the direction of the spec's
                x axis from the first.
            um: Distance between the points [um].

        Raises:
            UsageError: If the points are too close together.
        """
        across_px = second[0] - first[0]
        up_px = first[1] - second[1]
        across_px = -across_px if self.mirrored else across_px
        distance_px = math.hypot(across_px, up_px)
        if distance_px < DISTANCE_MIN_PX:
            raise UsageError(
                f"the two points are only {distance_px:.3g} px apart, but at least "
                f"{DISTANCE_MIN_PX} px are needed"
            )
        um_px = um / distance_px
        rotation = -math.atan2(up_px, across_px)
        relative_sd = math.sqrt(2) * POINT_SD_PX / distance_px
        lines = (
            f"{um_px:.4f} um/px +- {relative_sd * um_px:.4f}, if the points are accurate to "
            f"{POINT_SD_PX:g} px",
            f"rotation {rotation:.4f} rad +- {relative_sd:.4f}",
        )
        return Measured({"um_px": um_px, "rotation": rotation}, lines=lines)

    def placed(self, x_um: Lengths, y_um: Lengths, metres: float) -> tuple[Lengths, Lengths]:
        """Convert positions in the image [um] to the spec's coordinates; see `Microscope.placed`.

        `metres` is the length of the spec's unit [m].
        """
        cos = math.cos(self.rotation)
        sin = math.sin(self.rotation)
        scale = 1e-6 / metres
        x = self.corner[0] + scale * (cos * x_um - sin * y_um)
        return x, self.corner[1] + scale * (sin * x_um + cos * y_um)
