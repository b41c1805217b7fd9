"""Tags of the family 36h11 in a grey picture, found by OpenCV, and the picture of each tag."""

from dataclasses import dataclass

import cv2
import numpy as np

from tetractl.core.poses import Floats, Grey
from tetractl.lab.cameras.apriltag.refine import refined

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
        """Return every tag in the picture; a number twice where two tags show it."""
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
