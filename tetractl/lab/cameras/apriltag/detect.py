"""Tags of the family 36h11 in a grey picture, found by OpenCV, and the picture of each tag.

Corners are refined: each side of the black square is fitted by a line where the grey level changes
most, and neighbouring lines are intersected. A side has many pixels and a corner few: corners come
out several times better than by OpenCV's own refinements (benchmarks/apriltag.py).
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from tetractl.core.poses import Floats, Grey

MODULES = 8  # of a tag's side, black border included
ZERO = 0xD5D628584  # tag 0 as the AprilTag project prints it: its modules row by row, 1 is white
ENLARGED_BELOW = 1000  # columns; in narrower pictures a module is often too small to be read


@dataclass(frozen=True, slots=True)
class Sighting:
    """One tag in a picture.

    `corners` (4, 2) [px], pixel centres at whole numbers: top left, top right, bottom right and
    bottom left of the black square as the tag is read upright. `blur_px` is the standard deviation
    of the Gaussian that makes an edge as wide as the square's are.
    """

    tag: int
    corners: Floats
    blur_px: float

    @property
    def side_px(self) -> float:
        """Mean length of the four sides [px]."""
        return float(np.linalg.norm(self.corners - np.roll(self.corners, 1, axis=0), axis=1).mean())


class Detector:
    """Finds black squares, reads their modules, and refines the corners of those that are tags."""

    def __init__(self) -> None:
        parameters = cv2.aruco.DetectorParameters()
        parameters.adaptiveThreshWinSizeMin, parameters.adaptiveThreshWinSizeMax = 9, 21
        parameters.adaptiveThreshWinSizeStep = (
            12  # two thresholds: OpenCV's third costs and adds none
        )
        parameters.perspectiveRemovePixelPerCell = 8
        parameters.perspectiveRemoveIgnoredMarginPerCell = 0.33  # blur spoils a module's rim
        self._detector = cv2.aruco.ArucoDetector(_family(), parameters)
        self._top_left = 0
        # OpenCV's dictionary is turned against the AprilTag project's pictures, and its releases
        # may differ: which of its corners is the top left one is seen on a picture of tag 0
        square = np.kron(_zero(), np.ones((10, 10), np.uint8))
        (shown,) = self.find(np.pad(square, 20, constant_values=255))
        self._top_left = int(np.argmin(shown.corners.sum(axis=1)))

    def find(self, picture: Grey) -> list[Sighting]:
        """Return every tag in the picture; a number twice if two tags show it."""
        factor = 2 if picture.shape[1] < ENLARGED_BELOW else 1
        searched = picture
        if factor > 1:
            searched = cv2.resize(
                picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC
            )
        found, numbers, _ = self._detector.detectMarkers(searched)
        if numbers is None or not len(numbers):
            return []
        corners = (np.array(found, float).reshape(-1, 4, 2) + 0.5) / factor - 0.5
        corners, blurs = refined(picture, np.roll(corners, -self._top_left, axis=1), MODULES)
        return [
            Sighting(int(number), each, float(blur))
            for number, each, blur in zip(numbers.ravel(), corners, blurs, strict=True)
        ]


def tag_picture(number: int) -> Grey:
    """Return a tag as the AprilTag project prints it, one pixel a module, (8, 8), 0 or 255."""
    turns = next(k for k in range(4) if (np.rot90(_drawn(0), k) == _zero()).all())
    return np.ascontiguousarray(np.rot90(_drawn(number), turns))


def _family() -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)


def _drawn(number: int) -> Grey:
    """A tag as OpenCV draws it, whichever way that is turned."""
    return cv2.aruco.generateImageMarker(_family(), number, MODULES).astype(np.uint8)


def _zero() -> Grey:
    inside = [ZERO >> (35 - k) & 1 for k in range(36)]
    return np.pad(255 * np.array(inside, np.uint8).reshape(6, 6), 1)


ALONG = np.linspace(0.15, 0.85, 15)  # places on a side, away from the corners that blur rounds
ACROSS = np.linspace(-1.0, 1.0, 17)  # places on its normal, in shares of the reach
REACH = 0.9  # modules to either side: beyond lie the tag's inside and what is round the paper
ROUNDS = 2
NOTHING = 1e-9


def refined(picture: NDArray[np.uint8], corners: Floats, modules: int) -> tuple[Floats, Floats]:
    """Return corners (T, 4, 2) [px], refined from rough ones, and the blur of each tag (T,) [px].

    Corners run clockwise round a dark square of the given number of modules per side. The blur is
    the standard deviation of the Gaussian that makes a step as wide as the sides are. If the sides
    cannot be seen, the rough corners come back.
    """
    rough, blur = corners, np.zeros(len(corners))
    module = np.linalg.norm(rough - np.roll(rough, -1, axis=1), axis=-1).mean(axis=1) / modules
    offsets = REACH * module[:, None] * ACROSS  # (T, A)
    step = offsets[:, 1:] - offsets[:, :-1]
    between = (offsets[:, 1:] + offsets[:, :-1])[:, None, None] / 2
    for _ in range(ROUNDS):
        side = np.roll(corners, -1, axis=1) - corners
        along = side / (np.linalg.norm(side, axis=-1, keepdims=True) + NOTHING)
        outward = np.stack([along[..., 1], -along[..., 0]], axis=-1)
        places = corners[..., None, :] + ALONG[:, None] * side[..., None, :]  # (T, 4, S, 2)
        normals = outward[:, :, None, None] * offsets[:, None, None, :, None]
        grey = _sampled(picture, places[..., None, :] + normals)
        rise = np.maximum(np.diff(grey, axis=-1), 0.0)  # outward, black turns to white
        weight = rise**2 + NOTHING
        total = weight.sum(axis=-1)
        shift = (weight * between).sum(axis=-1) / total
        lines = _lines(places + shift[..., None] * outward[..., None, :], total)
        corners = _crossings(np.roll(lines, 1, axis=1), lines)
        profile = rise.mean(axis=(1, 2)) / step  # grey levels a pixel
        contrast = (profile * step).sum(axis=-1)
        blur = contrast / (profile.max(axis=-1) + NOTHING) / np.sqrt(2 * np.pi)
    moved = np.linalg.norm(corners - rough, axis=-1).max(axis=1)
    good = moved < 2 * module  # false for NaN too
    return np.where(good[:, None, None], corners, rough), blur


def _sampled(picture: NDArray[np.uint8], at: Floats) -> Floats:
    """Return the grey levels at pixels (..., M, 2), interpolated."""
    flat = at.reshape(-1, at.shape[-2], 2).astype(np.float32)
    across, down = flat[..., 0].copy(), flat[..., 1].copy()
    grey = cv2.remap(picture, across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return grey.reshape(at.shape[:-1]).astype(float)


def _lines(points: Floats, weight: Floats) -> Floats:
    """Fit lines a x + b y + c = 0, a^2 + b^2 = 1, to points (..., S, 2); return (..., 3)."""
    share = (weight / weight.sum(axis=-1, keepdims=True))[..., None]
    middle = (share * points).sum(axis=-2)
    spread = points - middle[..., None, :]
    _, axes = np.linalg.eigh(np.swapaxes(share * spread, -1, -2) @ spread)
    normal = axes[..., 0]  # of the smaller eigenvalue
    return np.concatenate([normal, -(normal * middle).sum(axis=-1, keepdims=True)], axis=-1)


def _crossings(one: Floats, other: Floats) -> Floats:
    """Return where lines (..., 3) cross, (..., 2); not finite if they are parallel."""
    meet = np.cross(one, other)
    with np.errstate(divide="ignore", invalid="ignore"):
        return meet[..., :2] / meet[..., 2:]
