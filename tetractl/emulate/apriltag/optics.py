"""The emulated camera's optics: where it hangs, what it sees, how badly."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from tetractl.core.poses import Floats
from tetractl.lab.cameras.apriltag.section import FloorTag

MM = 1e-3  # m


@dataclass(frozen=True, slots=True)
class Optics:
    """A pinhole camera that looks from `position` at `target` [m, z up], and its faults.

    `up` is the direction on the floor that is up in the picture [rad]. `distortion` holds OpenCV's
    k1, k2, p1, p2 and, optionally, k3. `blur_px` is the lens's Gaussian blur, `exposure_s` the time
    during which motion smears, `gain` multiplies the light, `noise` is the standard deviation of
    each pixel in grey levels at gain 1. `latency_s` passes from the middle of the exposure to the
    picture's departure.
    """

    width: int
    height: int
    focal_px: float
    position: tuple[float, float, float]
    target: tuple[float, float, float]
    up: float = math.pi / 2
    distortion: tuple[float, ...] = ()
    blur_px: float = 0.7
    exposure_s: float = 0.004
    noise: float = 2.0
    gain: float = 1.0
    latency_s: float = 0.05

    @classmethod
    def facing(
        cls,
        floor: Sequence[FloorTag],
        metres: float,
        width: int,
        height: int,
        view: float = 1.1,
        tilt: float = 0.35,
        up: float = math.pi / 2,
    ) -> Self:
        """Return a camera, as near as it can be, that sees all floor tags with some margin.

        `view` is the horizontal angle of view [rad] and `tilt` the angle between the optical axis
        and the vertical [rad].
        """
        centres = np.array([tag.at for tag in floor]) * metres
        around = 0.75 * max(tag.size_mm for tag in floor) * MM  # centre to the card's corner
        low, high = centres.min(axis=0) - around, centres.max(axis=0) + around
        corners = np.array([(x, y, 0.0) for x in (low[0], high[0]) for y in (low[1], high[1])])
        focal = width / 2 / math.tan(view / 2)
        x, y = map(float, (low + high) / 2)
        back = math.sin(tilt) * math.cos(up), math.sin(tilt) * math.sin(up)
        made = cls(width, height, focal, (x, y, 0.0), (x, y, 0.0), up)
        for distance in (np.geomspace(0.05, 100.0, 800) * np.hypot(*(high - low))).tolist():
            at = (x - distance * back[0], y - distance * back[1], distance * math.cos(tilt))
            pixels = replace(made, position=at).project(corners)
            size = np.array([width, height])
            if (np.ptp(pixels, axis=0) < 0.96 * size).all():
                return replace(made, position=at).centred(corners)
        raise ValueError("the floor tags fit in no picture")

    def centred(self, corners: Floats) -> Self:
        """Return the camera turned so that points (M, 3) [m] lie in the middle of the picture."""
        made = self
        for _ in range(8):
            pixels = made.project(corners)
            middle = (pixels.min(axis=0) + pixels.max(axis=0)) / 2
            x, y, _ = made.ground(middle)
            made = replace(made, target=(float(x), float(y), 0.0))
        return made

    @property
    def matrix(self) -> Floats:
        """The intrinsic matrix K, (3, 3), pixel centres at whole numbers."""
        across, down = (self.width - 1) / 2, (self.height - 1) / 2
        return np.array([[self.focal_px, 0, across], [0, self.focal_px, down], [0, 0, 1]])

    @property
    def axes(self) -> Floats:
        """The camera's right, down and forward in the arena's axes, (3, 3): a rotation."""
        forward = np.subtract(self.target, self.position)
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, (math.cos(self.up), math.sin(self.up), 0.0))
        right /= np.linalg.norm(right)
        return np.array([right, np.cross(forward, right), forward])

    def project(self, points: Floats) -> Floats:
        """Return the pixels (M, 2) of points (M, 3) [m], before distortion."""
        seen = (points - np.array(self.position)) @ self.axes.T
        return (seen[:, :2] / seen[:, 2:]) * self.focal_px + self.matrix[:2, 2]

    def ground(self, pixel: Floats) -> Floats:
        """Return where the ray of a pixel (2,) meets the floor, (3,) [m]."""
        ray = np.append((pixel - self.matrix[:2, 2]) / self.focal_px, 1.0) @ self.axes
        return np.array(self.position) - ray * self.position[2] / ray[2]
