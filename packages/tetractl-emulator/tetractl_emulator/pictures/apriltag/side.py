"""The emulated camera of type `apriltag`: its settings, its faults, and its rendered images.

Every image is synthetic. The emulated camera is a pinhole camera with known optics, so results from
its images can be compared with the truth.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import ClassVar, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from tetractl_microscope.apriltag.detect import MODULES, tag_picture
from tetractl_microscope.apriltag.section import AprilTagSection, FloorTag, RobotTag

from tetractl.core.clock import SECOND
from tetractl.core.poses import Floats, GreyImage, Poses
from tetractl.core.setup import MILLIMETRE_M
from tetractl.spec.base import Model, Name, NonNegative
from tetractl.spec.lab_section import entry
from tetractl_emulator.fault_rows import CAMERA_REASONS, FaultRow
from tetractl_emulator.faults import Fault, Visible, fault_kind
from tetractl_emulator.pictures.stream_side import (
    SPARE_PX,
    STREAM_FAULTS,
    StreamedCamera,
    StreamSettings,
)
from tetractl_emulator.sides import Body, Stage

VIEW = 2 * math.tan(1.1 / 2)  # a picture's width over the focal length: 63 degrees


@dataclass(frozen=True, slots=True)
class Optics:
    """A pinhole camera above the floor, with the imperfections of its lens and sensor.

    The direction up in the image is +y on the floor.

    Attributes:
        width: Number of columns [px].
        height: Number of rows [px].
        focal_px: Focal length [px].
        position: Position of the camera [m], with z up.
        target: Point at which the camera looks [m].
        distortion: OpenCV's coefficients k1, k2, p1, p2 and, optionally, k3. Empty for none.
        blur_px: Standard deviation of the lens's Gaussian blur [px].
        exposure_s: Exposure time [s].
        noise: Standard deviation of each pixel at gain 1 [grey levels].
        gain: Factor by which the light is multiplied.
    """

    width: int
    height: int
    focal_px: float
    position: tuple[float, float, float]
    target: tuple[float, float, float]
    distortion: tuple[float, ...] = ()
    blur_px: float = 0.7
    exposure_s: float = 0.004
    noise: float = 2.0
    gain: float = 1.0

    @classmethod
    def facing(
        cls, floor: Sequence[FloorTag], metres: float, width: int, height: int, tilt: float = 0.35
    ) -> Self:
        """Place a camera as near to the floor as possible so that it sees all floor tags.

        Args:
            floor: The floor tags.
            metres: Length unit of the spec [m].
            width: Width of an image [px].
            height: Height of an image [px].
            tilt: Angle between the optical axis and the vertical [rad].

        Raises:
            ValueError: If no such camera exists.
        """
        centres = np.array([tag.at for tag in floor]) * metres
        # from the centre of the largest card to its corner, rounded up [m]
        margin_m = 0.75 * max(tag.size_mm for tag in floor) * MILLIMETRE_M
        low = centres.min(axis=0) - margin_m
        high = centres.max(axis=0) + margin_m
        corners = np.array([(x, y, 0.0) for x in (low[0], high[0]) for y in (low[1], high[1])])
        x, y = ((low + high) / 2).tolist()
        camera = cls(width, height, width / VIEW, (x, y, 0.0), (x, y, 0.0))
        for distance in (np.geomspace(0.05, 100.0, 800) * np.hypot(*(high - low))).tolist():
            position = (x, y - distance * math.sin(tilt), distance * math.cos(tilt))
            camera = replace(camera, position=position)
            if (np.ptp(camera.project(corners), axis=0) < (0.96 * width, 0.96 * height)).all():
                return camera.centred(corners)
        raise ValueError("the camera cannot see all floor tags in one image")

    def centred(self, corners: Floats) -> Self:
        """Return a copy of this camera that is turned so that points are centred in its image.

        The camera keeps its position, and looks at a point of the floor.

        Args:
            corners: The points [m], shape (M, 3).
        """
        camera = self
        position = np.array(self.position)
        for _ in range(8):
            pixels = camera.project(corners)
            offset_px = (pixels.min(axis=0) + pixels.max(axis=0)) / 2 - camera.matrix[:2, 2]
            ray = np.append(offset_px / camera.focal_px, 1.0) @ camera.axes
            x, y, _ = (
                position - ray * position[2] / ray[2]
            ).tolist()  # where the ray meets the floor
            camera = replace(camera, target=(x, y, 0.0))
        return camera

    @property
    def matrix(self) -> Floats:
        """The intrinsic matrix K, shape (3, 3). Pixel centres have integer coordinates."""
        across = (self.width - 1) / 2
        down = (self.height - 1) / 2
        return np.array([[self.focal_px, 0, across], [0, self.focal_px, down], [0, 0, 1]])

    @property
    def axes(self) -> Floats:
        """The camera's directions right, down and forward in the arena's axes.

        The directions are the rows of a rotation matrix, shape (3, 3).
        """
        forward = np.subtract(self.target, self.position)
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, (0.0, 1.0, 0.0))
        right /= np.linalg.norm(right)
        return np.array([right, np.cross(forward, right), forward])

    def project(self, points: Floats) -> Floats:
        """Project points (M, 3) [m] to pixels (M, 2), column and row, without distortion."""
        in_camera = (points - np.array(self.position)) @ self.axes.T
        return (in_camera[:, :2] / in_camera[:, 2:]) * self.focal_px + self.matrix[:2, 2]


FLOOR = 150.0
"""Grey level of the floor at gain 1."""
WHITE = 225.0
"""Grey level of a tag's white modules at gain 1."""
BLACK = 25.0
"""Grey level of a tag's black modules at gain 1."""
MODULE_PX = 16
"""Side of a tag's module in the tag's texture [px]."""
CARD = MODULES + 2
"""Side of a printed tag, including its white margin [modules]."""
FINE = 4
"""Number of sub-pixels along a pixel's side. A pixel is the mean over its area."""
SUB_EXPOSURES = 6
"""Number of moments over which the image of an exposure is averaged."""

Shades = NDArray[np.float32]


class Renderer:
    """Renders images of the robots' tags and the floor tags. The same seed gives the same images.

    Args:
        robots: The robots' tags.
        floor: The floor tags.
        metres: Length unit of the spec [m].
        optics: The camera.
        seed: Seed of the noise.

    Attributes:
        hidden: Numbers of tags that are not drawn.
        strays: Further tags to draw on the floor.
    """

    def __init__(
        self,
        robots: Sequence[RobotTag],
        floor: Sequence[FloorTag],
        metres: float,
        optics: Optics,
        seed: int = 0,
    ) -> None:
        self.robots = robots
        self.floor = floor
        self.metres = metres
        self.optics = optics
        self.seed = seed
        self.hidden = set[int]()
        self.strays: list[FloorTag] = []
        self._empty: tuple[frozenset[int], Shades] | None = None
        self._pictures = 0
        self._corner = -1, -1  # of the last picture's noise, in the larger array

    def picture(self, poses_at: Callable[[int], Poses], exposed_ns: int) -> GreyImage:
        """Render the image of an exposure, shape (height, width).

        Args:
            poses_at: Returns the robots' poses at a time [ns], in the spec's unit.
            exposed_ns: Middle of the exposure [ns].
        """
        canvas = self._background().copy()
        half = self.optics.exposure_s * SECOND / 2
        moments = half * (2 * np.arange(SUB_EXPOSURES) + 1 - SUB_EXPOSURES) / SUB_EXPOSURES
        poses = [poses_at(exposed_ns + round(moment)) for moment in moments]
        for i, robot in enumerate(self.robots):
            if robot.tag in self.hidden:
                continue
            corners = [self.card(robot, moment_poses, i) for moment_poses in poses]
            is_still = np.ptp(corners, axis=0).max() < 0.05
            self._stamp(canvas, texture(robot.tag), corners[:1] if is_still else corners)
        for stray in self.strays:
            self._lay(canvas, stray)
        return self._finished(canvas)

    def card(self, robot: RobotTag, poses: Poses, i: int) -> Floats:
        """Project the corners of a robot's card to pixels, without distortion.

        The card is the tag with its white margin.

        Args:
            robot: The robot's tag.
            poses: The poses of all robots.
            i: Index of the robot.

        Returns:
            The corners, clockwise from the top left corner, shape (4, 2).
        """
        heading = poses.heading[i] - robot.heading_offset
        return self._card((poses.x[i], poses.y[i]), robot.height_mm, heading, robot.size_mm)

    def _card(
        self, position: tuple[float, float], height_mm: float, heading: float, side_mm: float
    ) -> Floats:
        """Project the corners of a card to pixels (4, 2).

        `position` is in length units of the spec, and `heading` in rad. `side_mm` is the side of
        the tag without its white margin.
        """
        half = side_mm * MILLIMETRE_M * CARD / MODULES / 2
        square = half * np.array([(-1, 1), (1, 1), (1, -1), (-1, -1)])
        cos = math.cos(heading)
        sin = math.sin(heading)
        corners_m = square @ np.array([(cos, sin), (-sin, cos)]) + self.metres * np.array(position)
        return self.optics.project(
            np.column_stack([corners_m, np.full(4, height_mm * MILLIMETRE_M)])
        )

    def _background(self) -> Shades:
        """Return the image of the floor with its tags. It is redrawn if `hidden` has changed."""
        hidden = frozenset(self.hidden)
        if self._empty is None or self._empty[0] != hidden:
            light = np.linspace(0.92, 1.06, self.optics.width)  # brighter on one side
            canvas = np.tile(FLOOR * light, (self.optics.height, 1)).astype(np.float32)
            for tag in self.floor:
                if tag.tag not in hidden:
                    self._lay(canvas, tag)
            self._empty = hidden, canvas
        return self._empty[1]

    def _lay(self, canvas: Shades, tag: FloorTag) -> None:
        """Draw a floor tag on the canvas, at height 0."""
        corners = self._card(tag.at, 0.0, tag.heading, tag.size_mm)
        self._stamp(canvas, texture(tag.tag), [corners])

    def _stamp(self, canvas: Shades, texture: Shades, exposures: Sequence[Floats]) -> None:
        """Draw a card on the canvas, averaged over its positions during the exposure.

        Each position is given by the four corners [px]. A part outside the canvas is left out.
        """
        corners = np.concatenate(exposures)
        first = np.floor(corners.min(axis=0)).astype(int)
        last = np.ceil(corners.max(axis=0)).astype(int)
        low = np.maximum(first - 1, 0)
        high = np.minimum(last + 2, canvas.shape[::-1])
        if (low >= high).any():
            return
        across, down = (high - low).tolist()
        side = len(texture)
        source = np.array([(0, 0), (side, 0), (side, side), (0, side)], np.float32) - 0.5
        ink = np.zeros((down, across, 2), np.float32)
        for exposed_corners in exposures:
            fine_corners = (exposed_corners - low + 0.5) * FINE - 0.5
            transform = cv2.getPerspectiveTransform(source, fine_corners.astype(np.float32))
            drawn = cv2.warpPerspective(texture, transform, (across * FINE, down * FINE))
            ink += cv2.resize(drawn, (across, down), interpolation=cv2.INTER_AREA)
        ink /= len(exposures)
        region = canvas[low[1] : high[1], low[0] : high[0]]
        region *= 1 - ink[..., 1]
        region += ink[..., 0]

    def _finished(self, canvas: Shades) -> GreyImage:
        """Apply distortion, blur, noise and gain to an image, and round it to grey levels.

        Grey levels are limited to 0 to 255.
        """
        optics = self.optics
        if any(optics.distortion):
            cv2.remap(canvas.copy(), *self._bent, cv2.INTER_LINEAR, canvas, borderValue=FLOOR)
        if optics.blur_px:
            cv2.GaussianBlur(canvas, (0, 0), optics.blur_px, canvas)
        if optics.noise:
            canvas += optics.noise * self._grain(*canvas.shape)
        return np.clip(canvas * optics.gain + 0.5, 0, 255).astype(np.uint8)

    @cached_property
    def _noise(self) -> Shades:
        """Standard normal noise, larger than an image by SPARE_PX."""
        draw = np.random.default_rng(self.seed).standard_normal
        return draw((self.optics.height + SPARE_PX, self.optics.width + SPARE_PX), np.float32)

    def _grain(self, height: int, width: int) -> Shades:
        """Sample standard normal noise, shape (height, width), as a part of a larger array.

        The part differs from the part for the previous image, because a real camera never sends
        exactly the same image of stationary robots twice.
        """
        self._pictures += 1
        random_generator = np.random.default_rng((self.seed, self._pictures))
        x, y = random_generator.integers(0, SPARE_PX, 2).tolist()
        if (x, y) == self._corner:
            x = (x + 1) % SPARE_PX
        self._corner = x, y
        return self._noise[x : x + height, y : y + width]

    @cached_property
    def _bent(self) -> tuple[Shades, Shades]:
        """Position in the undistorted image of each pixel of the distorted image.

        The two arrays, each of shape (height, width), contain the columns and the rows [px].
        """
        optics = self.optics
        rows, columns = np.indices((optics.height, optics.width), dtype=np.float32)
        pixels = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2)
        lens = np.array(optics.distortion)
        ideal = cv2.undistortPoints(pixels, optics.matrix, lens, P=optics.matrix)
        ideal = ideal.reshape(optics.height, optics.width, 2).astype(np.float32)
        return ideal[..., 0].copy(), ideal[..., 1].copy()


@cache
def texture(number: int) -> Shades:
    """Draw the printed card of a tag.

    Args:
        number: Number of the tag.

    Returns:
        The grey level and a coverage of 1 at each pixel, shape (side, side, 2).
    """
    modules = np.pad(tag_picture(number), 1, constant_values=255) / 255
    grey = np.kron(BLACK + (WHITE - BLACK) * modules, np.ones((MODULE_PX, MODULE_PX)))
    return np.stack([grey, np.ones_like(grey)], axis=-1).astype(np.float32)


class AprilTagSettings(StreamSettings):
    """Properties of the emulated camera; its latency [s] is the spec's."""

    blur_px: NonNegative = 0.7
    """Gaussian blur of the lens [px]."""


class EmulatedAprilTag(StreamedCamera):
    """An emulated network camera above robots with AprilTags.

    Args:
        stage: The data and functions that the lab's emulated devices share.
        settings: The settings of the camera.
        bodies: The bodies that carry tags.
    """

    Settings: ClassVar[type[Model]] = AprilTagSettings
    faults: ClassVar[Sequence[type[Fault]]] = (
        *STREAM_FAULTS,
        fault_kind(
            "untracked",
            "A robot's tag is covered.",
            Visible.EXPOSED,
            fields={"robot": Name},
            rows=[FaultRow("untracked", CAMERA_REASONS)],
        ),
    )

    def __init__(self, stage: Stage, settings: AprilTagSettings, bodies: Sequence[Body]) -> None:
        super().__init__(stage, settings, bodies)
        section = stage.lab.camera
        assert isinstance(section, AprilTagSection), "the camera's section has the type apriltag"
        metres = stage.setup.metres
        optics = replace(
            Optics.facing(section.floor, metres, settings.width, settings.height),
            blur_px=settings.blur_px,
            noise=settings.noise,
            exposure_s=settings.exposure,
        )
        robots = [entry(section.robots, name) for name in stage.setup.names]
        self.renderer = Renderer(robots, section.floor, metres, optics, self.seed)

    def _scene(self) -> Floats:
        """Return x, y [length unit] and heading [rad] of each robot, shape (N, 3)."""
        unit_mm = self._stage.mm
        return np.array(
            [(body.x / unit_mm, body.y / unit_mm, body.heading) for body in self._bodies]
        )

    def _draw(self, exposed_ns: int) -> GreyImage:
        """Render the image of an exposure at a time [ns].

        Robots that are carried or covered have no tag.
        """
        tags = zip(self.renderer.robots, self._visible_now(), strict=True)
        self.renderer.hidden = {robot.tag for robot, is_visible in tags if not is_visible}
        return self.renderer.picture(lambda t: Poses.from_array(self._scene_at(t)), exposed_ns)
