"""Makes the film in a log: a crop of each cell in every picture, and one whole picture a second."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.core.cell_film import CellFilm, cut
from tetractl.core.clock import SECOND
from tetractl.core.poses import Grey
from tetractl_microscope.cells.cell import SeenCell
from tetractl_microscope.cells.detect_cells import Blob, blobs_of, box_px
from tetractl_microscope.cells.tracking import CellTracker

STEP, LEAST, MOST = 16, 32, 160  # step, smallest and largest side of crops [px]
ROOM = 2.0  # ratio of a crop's side to the length of the longest cell
HERE_UM = 15.0  # largest distance of a robot's filtered position from its blob
WHOLE_NS = SECOND  # interval between whole pictures
BACKGROUND_NS = 10 * SECOND  # interval between backgrounds


@dataclass(slots=True)
class FilmCutter:
    """Selects the crops and whole pictures of one run for its log."""

    _whole_ns: int = -WHOLE_NS
    _background_ns: int = -BACKGROUND_NS

    def film(
        self,
        picture: Grey,
        exposed_ns: int,
        cells: Sequence[SeenCell],
        robots: Sequence[SeenCell | None],
        tracker: CellTracker,
    ) -> CellFilm:
        """Return the film's data for a picture; `robots` are the robots' cells, None if unseen."""
        searched, background = tracker.finder.searched, tracker.finder.background
        longest = max((cell.long_um for cell in cells), default=0.0) / tracker.um_px
        side = int(np.clip(STEP * np.ceil(ROOM * longest / STEP), LEAST, MOST))
        rim = box_px(tracker.finder.least_px2)  # the margin around a blob on which it depends
        blobs = [(c, b) for c in cells if (b := tracker.blob(c.track)) and not b.at_edge]
        kept = [(c, b) for c, b in blobs if max(b.body.shape) <= side - rim]
        corners = [_corner(blob, side) for _, blob in kept]
        crops = [cut(searched, column, row, side) for column, row in corners]
        tracks = [-1 if cell is None else cell.track for cell in robots]
        found_at = [_off(c, b, picture.shape[0], tracker.um_px) < HERE_UM for c, b in kept]
        whole = exposed_ns - self._whole_ns >= WHOLE_NS
        bare = exposed_ns - self._background_ns >= BACKGROUND_NS
        self._whole_ns = exposed_ns if whole else self._whole_ns
        self._background_ns = exposed_ns if bare else self._background_ns
        return CellFilm(
            sampled_ns=exposed_ns,
            crops=np.array(crops, np.uint8).reshape(-1, side, side),
            corners=np.array(corners, np.int64).reshape(-1, 2),
            blobs=np.array([numbers(blob) for _, blob in kept]).reshape(-1, 6),
            robots=np.array(
                [
                    tracks.index(cell.track) if here and cell.track in tracks else -1
                    for here, (cell, _) in zip(found_at, kept, strict=True)
                ],
                np.int64,
            ),
            merged=np.array([cell.merged for cell, _ in kept], np.bool_),
            limits=tracker.finder.limits,
            sure=np.array([np.nan if cell is None else cell.probability for cell in robots]),
            whole=picture.copy() if whole else None,
            background=background.copy() if bare and background is not None else None,
        )


def _off(cell: SeenCell, blob: Blob, height: int, um_px: float) -> float:
    """Return the distance [um] of a cell from its blob's middle in a picture with `height` rows."""
    x, y = (blob.x + 0.5) * um_px, (height - 0.5 - blob.y) * um_px
    return math.hypot(cell.x - x, cell.y - y)


def _corner(blob: Blob, side: int) -> tuple[int, int]:
    """Return the upper left pixel of a crop centred on a blob."""
    rows, columns = blob.body.shape
    return blob.corner[0] + columns // 2 - side // 2, blob.corner[1] + rows // 2 - side // 2


def numbers(blob: Blob) -> tuple[float, ...]:
    """Return a blob's x, y [px], axis [rad], length, width [px] and strength [grey levels]."""
    return blob.x, blob.y, blob.axis, blob.long, blob.wide, blob.strength


def found_again(
    crop: Grey, place: Sequence[int], stated: Sequence[float], limits: Sequence[float]
) -> tuple[float, ...] | None:
    """Search a crop, whose upper left pixel is at `place`, for blobs again; return the `numbers` of
    the blob nearest to the position in `stated`, None if there is no blob.
    """
    blobs = map(numbers, blobs_of(crop, limits, (place[0], place[1])))
    x, y = stated[:2]
    return min(blobs, key=lambda one: (one[0] - x) ** 2 + (one[1] - y) ** 2, default=None)
