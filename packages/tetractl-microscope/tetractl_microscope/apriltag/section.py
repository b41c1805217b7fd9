"""The section of a spec for the `apriltag` camera: its tags, their positions and the lens.

Lengths whose name ends in `_mm` are millimetres, whatever the spec's length unit; times are
seconds. OpenCV is imported only if the camera is built.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from tetractl.core.setup import Setup
from tetractl.spec.base import (
    Angle,
    Finite,
    Model,
    NonNegative,
    Point,
    Positive,
    inconsistent,
)
from tetractl.spec.lab_section import RobotPart, entry, mismatches
from tetractl.spec.yaml.problems import Loc
from tetractl_microscope.pictures.picture_section import PictureSection

Tag = Annotated[int, Field(ge=0, lt=587)]
"""The number of a tag of the family 36h11, which has 587."""


class Lens(Model):
    """A calibrated lens, for images of the size that the source delivers."""

    focal_px: Positive
    """Focal length of the lens, in pixels of the source's images [px]."""
    centre: Point | None = None
    """Principal point: column and row [px]. By default, the middle of the image."""
    distortion: tuple[Finite, ...] = ()
    """OpenCV's distortion coefficients: k1, k2, p1, p2 and, optionally, k3. None by default."""

    @model_validator(mode="after")
    def _known_model(self) -> Self:
        if len(self.distortion) not in (0, 4, 5):
            raise inconsistent(
                "distortion", "needs 4 or 5 lens coefficients, in the order k1, k2, p1, p2 and k3"
            )
        return self


class RobotTag(RobotPart):
    """The tag on a robot. Its centre is the robot's position."""

    tag: Tag
    """Number of the robot's tag."""
    size_mm: Positive
    """Side of the tag's black square [mm]."""
    height_mm: NonNegative
    """Height of the tag above the floor [mm]."""
    heading_offset: Angle = 0.0
    """Angle from the direction in which the upright tag is read, from left to right, to the robot's
    front [rad]. 0 if the tag's top edge is on the robot's left."""


class FloorTag(Model):
    """A tag on the floor at a known position."""

    tag: Tag
    """Number of the tag."""
    at: Point
    """Centre of the tag in the spec's coordinates [length unit]."""
    size_mm: Positive
    """Side of the tag's black square [mm]."""
    heading: Angle = 0.0
    """Direction in which the upright tag is read, from left to right, as an angle from the spec's x
    axis [rad]. 0 if the tag's top edge points along the spec's y axis."""


class AprilTagSection(PictureSection):
    """A camera that looks down on robots with AprilTags."""

    device: ClassVar[str] = "tetractl_microscope.apriltag.camera:AprilTagCamera"
    type: Literal["apriltag"]
    family: Literal["36h11"] = "36h11"
    """The family of the tags."""
    robots: tuple[RobotTag, ...] = Field(min_length=1, max_length=32)
    """One entry for each robot of the spec, with its tag."""
    floor: tuple[FloorTag, ...] = Field(min_length=4, max_length=16)
    """Tags around the arena that define the floor. One image must show all of them."""
    lens: Lens | None = None
    """The calibrated lens. By default, the floor tags give focal length and distortion."""

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        for tag, count in Counter(printed.tag for printed in (*self.robots, *self.floor)).items():
            if count > 1:
                raise inconsistent(
                    "floor", f"tag {tag} is used twice; each tag number may be used only once"
                )
        if _are_collinear([tag.at for tag in self.floor]):
            raise inconsistent("floor", "the floor tags must not lie on one line")
        return self

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield the place and text of each problem with the robots or their tags."""
        yield from mismatches(self.robots, setup.names)

    def heading_offset(self, name: str) -> float:
        """Return the angle added to the heading of a robot's tag [rad]."""
        return entry(self.robots, name).heading_offset


def _are_collinear(points: Sequence[Point]) -> bool:
    """Decide whether points lie nearly on one line.

    Two different points always do.
    """
    (first_x, first_y), *other_points = points
    offsets = [(x - first_x, y - first_y) for x, y in other_points]
    squared_length = max(x * x + y * y for x, y in offsets)
    area = max(abs(ax * by - ay * bx) for ax, ay in offsets for bx, by in offsets)
    return area < 0.01 * squared_length
