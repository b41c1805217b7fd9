"""Read the microscope images in a log, reduced for display, and their position in the dish."""

import io
import math
from bisect import bisect_right

import numpy as np
from PIL import Image

from tetractl.core.poses import Floats, GreyImage
from tetractl.log.read.trial_log import TrialLog

SHOWN_SIDE_MAX_PX = 720
"""Maximum length of the longer side of an image that is displayed [px]."""
REPORT_IMAGES_MAX = 120
"""Maximum number of images per trial in a report."""
LOGGED_SIDE_MAX_PX = 8192
"""Maximum length of the longer side of an image in a log that is read [px]."""
JPEG_QUALITY = 60
"""JPEG quality of the images in a report, from 1 to 100."""


class DishPictures:
    """The readable microscope images of one trial. Only logs of a microscope contain images.

    Args:
        log: The trial's log.
        count_max: Maximum number of images, which are spread over the trial. By default, all images
            are read.

    Attributes:
        times_ns: When the images were taken, on the trial's clock [ns].
        corners: Positions of an image's lower left, lower right and upper left corner in the spec's
            coordinates [length unit], shape (3, 2).
    """

    def __init__(self, log: TrialLog, count_max: int | None = None) -> None:
        camera = log.experiment.plant.microscope
        logged = log.pictures if camera is not None else ()
        stride = 1 if count_max is None else max(1, math.ceil(len(logged) / count_max))
        self.times_ns: list[int] = []
        self._greys: list[Image.Image] = []
        self.corners: Floats = np.zeros((3, 2))
        for time_ns, data in logged[::stride]:
            reduced = _decode_reduced(data)
            if reduced is None:
                continue
            grey, size_px = reduced
            if camera is not None and not self._greys:
                width_um, height_um = (length_px * camera.um_px for length_px in size_px)
                corners_um = ((0.0, 0.0), (width_um, 0.0), (0.0, height_um))
                metres = log.start.setup.metres
                self.corners = np.array([camera.placed(x, y, metres) for x, y in corners_um])
            self.times_ns.append(time_ns)
            self._greys.append(grey)

    def index_at(self, when_ns: int) -> int | None:
        """Find the newest image that was taken no later than `when_ns` [ns].

        Returns:
            The index of the image, or 0 for a time before the first image. None without images.
        """
        return max(bisect_right(self.times_ns, when_ns) - 1, 0) if self.times_ns else None

    def grey(self, index: int) -> GreyImage:
        """Return the grey levels of an image, shape (height, width), with the upper row first."""
        return np.asarray(self._greys[index])

    def jpeg(self, index: int) -> bytes:
        """Encode an image, and return the contents of a JPEG file."""
        file = io.BytesIO()
        self._greys[index].save(file, "JPEG", quality=JPEG_QUALITY)
        return file.getvalue()


def _decode_reduced(data: bytes) -> tuple[Image.Image, tuple[int, int]] | None:
    """Decode a JPEG in grey levels, reduced to at most SHOWN_SIDE_MAX_PX pixels per side.

    Returns:
        The image, and its original width and height [px]. None if it cannot be read.
    """
    try:
        picture = Image.open(io.BytesIO(data), formats=["JPEG"])
        size_px = picture.size
        if max(size_px) > LOGGED_SIDE_MAX_PX:
            return None
        picture.draft("L", (SHOWN_SIDE_MAX_PX, SHOWN_SIDE_MAX_PX))
        grey = picture.convert("L")
        grey.thumbnail((SHOWN_SIDE_MAX_PX, SHOWN_SIDE_MAX_PX))
        return grey, size_px
    except Exception:  # Pillow's exceptions for hostile bytes are not documented
        return None
