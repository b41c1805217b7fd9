"""What disturbs a film besides its cells is said, and an undisturbed film is not."""

import re

import numpy as np
import pytest
from support.dish_films import Reel, film
from support.needs_opencv import cv2
from tetractl_microscope.film.follow import follow
from tetractl_microscope.organisms import TETRAHYMENA

pytestmark = pytest.mark.slow

SIDE = 256
RATE = 10.0


@pytest.fixture(scope="module")
def synthetic():
    return film(seed=31, side=SIDE, cells=2, crossings=False, seconds=4.2, rate=RATE)


@pytest.fixture(scope="module")
def pictures(synthetic):
    return list(synthetic.pictures())


def undisturbed(k, picture):
    return picture


def wandering(k, picture):
    tilt = 0.35 * np.sin(k / 6) * np.linspace(-1, 1, SIDE)
    return np.clip(picture * (1 + tilt), 0, 255).astype(np.uint8)


def bubbling(k, picture):
    return cv2.circle(picture.copy(), (6 * k, 120), 55, 20, 4)


def drifting(k, picture):
    by = np.array([[1.0, 0.0, 0.9 * k], [0.0, 1.0, 0.0]])
    return cv2.warpAffine(picture, by, (SIDE, SIDE), borderMode=cv2.BORDER_REPLICATE)


@pytest.mark.long
@pytest.mark.parametrize(
    ("change", "said"),
    [
        (undisturbed, []),
        (wandering, ["light wanders in the picture, by"]),
        (bubbling, ["um wide, such as a bubble, moves or grows"]),
        (drifting, ["what does not swim moves by 21 um/s: the stage drifts"]),
    ],
)
def test_disturbances_are_said(change, said, synthetic, pictures):
    reel = Reel(synthetic, [change(k, picture) for k, picture in enumerate(pictures)])
    tracked = follow(reel, synthetic.look.um_px, None, TETRAHYMENA).remarks
    disturbance = re.compile("wanders|moves or grows|does not swim")
    lines = [line for line in tracked if disturbance.search(line)]
    assert len(lines) == len(said), tracked
    for line, words in zip(lines, said, strict=True):
        assert words in line
