"""Keeps the floor calibrated while its tags are seen."""

from collections.abc import Mapping, Sequence

import numpy as np

from tetractl.core.poses import Floats
from tetractl.lab.cameras.apriltag.calibrate import calibrated
from tetractl.lab.cameras.apriltag.plane import MM, Plane, placed
from tetractl.lab.cameras.apriltag.section import FloorTag, Lens

MOVED_PX = 3.0  # a floor tag this far from its mean was moved, or the camera was
AVERAGED = 32  # pictures
MISFIT_MM = 10.0  # floor tags further off than this are not where the spec puts them


class Floor:
    """Keeps the plane calibrated from the floor tags while they are seen.

    The corners are averaged over some pictures, for neither the camera nor a floor tag moves. Where
    one does, by `MOVED_PX`, the plane is given up until all floor tags are seen in one picture
    again; a plane on which they do not lie as the spec says, by `MISFIT_MM`, is not used.
    """

    def __init__(
        self, tags: Sequence[FloorTag], metres: float, lens: Lens | None, highest_mm: float
    ) -> None:
        self.plane: Plane | None = None
        self.misfit: Plane | None = None
        self._numbers = [tag.tag for tag in tags]
        self._places = np.array([placed(tag, metres) for tag in tags])  # (F, 4, 2) m
        self._lens, self._highest = lens, highest_mm * MM
        self._mean: Floats | None = None
        self._count = 0

    def see(self, corners: Mapping[int, Floats], size: tuple[int, int]) -> None:
        """Account for the floor tags of one picture: corners (4, 2) [px] by tag, each seen once.

        `size` is the picture's width and height.
        """
        seen = {i: corners[n] for i, n in enumerate(self._numbers) if n in corners}
        if self._mean is not None and any(
            np.abs(each - self._mean[i]).max() > MOVED_PX for i, each in seen.items()
        ):
            self._mean = self.plane = self.misfit = None
        if len(seen) < len(self._numbers):
            return
        now = np.array([seen[i] for i in range(len(seen))])
        if self._mean is None:
            self._mean, self._count = now, 0
        self._count += 1
        self._mean = self._mean + (now - self._mean) / min(self._count, AVERAGED)
        if self._count % AVERAGED == 0 or self._count.bit_count() == 1:
            plane = calibrated(self._mean, self._places, size, self._lens, self._highest)
            fits = plane.worst_mm <= MISFIT_MM
            self.plane, self.misfit = (plane, None) if fits else (None, plane)
