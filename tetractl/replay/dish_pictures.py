"""Reads the microscope's pictures in a log, reduced for display, and their place in the dish."""

import io
from bisect import bisect_right

import numpy as np
from PIL import Image

from tetractl.core.poses import Floats, Grey
from tetractl.log.read.trial_log import TrialLog

SHOWN_SIDE = 720  # longer side of a picture as shown [px]
PICTURES_MAX = 120  # largest number of pictures per trial in a report


class DishPictures:
    """The readable pictures of one trial, at most `most`; only logs of a microscope have any.

    `times` are when the pictures were taken, on the trial's clock [ns]. `corners` (3, 2) are the
    positions of a picture's lower left, lower right and upper left corner in the spec's
    coordinates.
    """

    def __init__(self, log: TrialLog, most: int | None = None) -> None:
        camera = log.experiment.plant.microscope
        found = log.pictures if camera else ()
        every = 1 if most is None else max(1, -(-len(found) // most))
        read = [(at, picture) for at, data in found[::every] if (picture := _small(data))]
        self.times = [at for at, _ in read]
        self._pictures = [picture for _, (picture, _) in read]
        self.corners: Floats = np.zeros((3, 2))
        if camera is not None and read:
            (width, height), metres = read[0][1][1], log.start.setup.metres
            ends = ((0.0, 0.0), (width * camera.um_px, 0.0), (0.0, height * camera.um_px))
            self.corners = np.array([camera.placed(x, y, metres) for x, y in ends])

    def at(self, when_ns: int) -> int | None:
        """Return the index of the last picture taken up to a time [ns], 0 for an earlier time; None
        if there are no pictures.
        """
        return max(bisect_right(self.times, when_ns) - 1, 0) if self.times else None

    def grey(self, which: int) -> Grey:
        """Return the grey levels (height, width) of a picture, with the upper row first."""
        return np.asarray(self._pictures[which])

    def jpeg(self, which: int) -> bytes:
        """Return a picture as a JPEG file."""
        file = io.BytesIO()
        self._pictures[which].save(file, "JPEG", quality=60)  # JPEG quality, 1 to 100
        return file.getvalue()


def _small(data: bytes) -> tuple[Image.Image, tuple[int, int]] | None:
    """Return a JPEG in grey levels, reduced to at most SHOWN_SIDE pixels per side, and its original
    width and height; None if it cannot be read.
    """
    try:
        picture = Image.open(io.BytesIO(data), formats=["JPEG"])
        size = picture.size
        if max(size) > 8192:  # longest side of a picture [px]
            return None
        picture.draft("L", (SHOWN_SIDE, SHOWN_SIDE))
        grey = picture.convert("L")
        grey.thumbnail((SHOWN_SIDE, SHOWN_SIDE))
        return grey, size
    except Exception:  # Pillow's exceptions for hostile bytes are not documented
        return None
