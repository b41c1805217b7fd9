"""Searches any answer of a network camera for cells, as a target for fuzzing."""

import math
from functools import cache

import numpy as np
from tetractl_emulator.pictures.network_camera import BOUNDARY, coded, part
from tetractl_microscope.cells.detect_cells import BLOBS_MAX
from tetractl_microscope.cells.tracking import CellTracker
from tetractl_microscope.pictures.feed import Picture
from tetractl_microscope.pictures.multipart import Multipart
from tetractl_microscope.pictures.source import decode_to_grey

from testkit.microscope.dish_films import film
from testkit.targets import Target

SIDE = 128  # of a picture [px]


@cache
def _dish() -> tuple[list, list[bytes]]:
    """The pictures of a small film, and answers of a camera: that film, and absurd pictures."""
    pictures_shown = list(film(seed=3, side=SIDE, cells=2, seconds=0.5).pictures())
    black = np.zeros((SIDE, SIDE), np.uint8)
    noise = np.random.default_rng(1).integers(0, 2, (64, 64))
    blobs = np.kron(255 * noise, np.ones((2, 2))).astype(np.uint8)
    absurd = [
        pictures_shown[0],
        black,
        black + 255,
        blobs,
        pictures_shown[1],
        np.zeros((40, 9), np.uint8),
        pictures_shown[2],
    ]
    return pictures_shown, [_answer(pictures_shown), _answer(absurd)]


def _answer(sent: list) -> bytes:
    """What a camera answers that sends some pictures."""
    return b"".join(part(coded(picture, 90)) for picture in sent)


def pictures(data: bytes) -> None:
    """What a network camera answers, searched for cells."""
    tracker = CellTracker(2.3, field_known=True)
    parts = Multipart(BOUNDARY)
    tracker.finder.learn(_dish()[0])
    for k, body in enumerate(parts.feed(data)[:20]):
        grey = decode_to_grey(Picture(body, 0), (SIDE, SIDE))
        if grey is None:
            continue
        cells = tracker.track_image(grey, k / 30, lambda start, end: [(end - start, 1.0, 0.0)])
        assert len(cells) <= BLOBS_MAX
        for cell in cells:
            assert all(map(math.isfinite, (cell.x, cell.y, cell.heading, *cell.mean)))
            assert 0 <= cell.probability <= 1


TARGETS = {"pictures": Target(pictures, lambda: _dish()[1])}
