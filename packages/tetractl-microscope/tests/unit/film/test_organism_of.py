"""The organism of a film is recognised by what swims in it, and what is not followed is said."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from support.needs_opencv import cv2
from tetractl_microscope.film.organism_of import recognised
from tetractl_microscope.film.picture_times import PictureTimes
from tetractl_microscope.organisms import (
    EUGLENA,
    HELICAL_MICROROBOT,
    PARAMECIUM,
    TETRAHYMENA,
    named,
)
from tetractl_microscope.registries import ORGANISMS

from tetractl.core.errors import Exit, TetractlError

pytestmark = pytest.mark.slow

SIDE = 400
RATE_HZ = 30.0
COUNT = 6


@dataclass
class Ellipses:
    """A film of COUNT ellipses, `long` by `wide` [px], that swim along their axes."""

    long: float
    wide: float
    speed_px_s: float
    path: Path = Path("ellipses.avi")
    rate_hz: float = RATE_HZ

    @property
    def timing(self):
        return PictureTimes(self.rate_hz)

    def __iter__(self):
        for number in range(120):
            picture = np.full((SIDE, SIDE), 200, np.uint8)
            way = self.speed_px_s * self.seconds(number)
            for i in range(COUNT):
                angle = 0.3 * i - 0.8
                x = 70 + way * math.cos(angle)
                y = 60 + 55 * i + way * math.sin(angle)
                centre = (round(16 * x), round(16 * y))
                axes = (8 * self.long, 8 * self.wide)
                size = tuple(round(axis) for axis in axes)
                turned = math.degrees(angle)
                cv2.ellipse(picture, centre, size, turned, 0, 360, 90, -1, cv2.LINE_AA, 4)
            yield number, picture

    def seconds(self, number):
        return number / self.rate_hz


def swimming(kind, um_px):
    """A film of the organism's usual size and speed."""
    long, wide = kind.body_um
    speed = math.sqrt(math.prod(kind.speed_um_s))
    return Ellipses(long / um_px, wide / um_px, speed / um_px)


@pytest.mark.parametrize("name", ORGANISMS.names())
def test_an_organism_is_recognised_by_its_size_and_speed(name):
    kind = named(name)
    um_px = kind.body_um[1] / 9
    film = swimming(kind, um_px)
    recognition = recognised(film, um_px)
    assert recognition.organism is kind and recognition.um_px == um_px and not recognition.guessed
    assert recognition.remarks[0].startswith(f"cells are taken for {name}: ")
    assert len(recognition.remarks) == 1


@pytest.mark.long
def test_other_swimmers_than_those_chosen_are_counted_and_named():
    film = swimming(PARAMECIUM, 6.0)
    said, coarse = recognised(film, 6.0, TETRAHYMENA).remarks
    assert "tetrahymena is 4.4 px wide at 6 um/px; 8 px or more are needed" in coarse
    assert "objects that move have not the size and speed of tetrahymena" in said
    assert said.endswith("--organism paramecium follows them, if they swim and do not drift")
    assert recognised(film, 6.0, PARAMECIUM).remarks == ()


@pytest.mark.long
def test_what_swims_but_is_like_no_organism_ends_the_run_unless_one_is_named():
    worms = Ellipses(40.0, 12.0, 60.0)  # 400 um long, 120 um wide
    with pytest.raises(TetractlError, match="no known organism: ") as refused:
        recognised(worms, 10.0)
    assert refused.value.exit == Exit.FAILED and "--organism NAME" in refused.value.hint
    assert recognised(worms, 10.0, PARAMECIUM).organism is PARAMECIUM


@dataclass
class Beads(Ellipses):
    """A film of 25 round beads, which make an independent step from picture to picture."""

    def __iter__(self):
        random = np.random.default_rng(5)
        places = np.array([(50 + 75 * (i % 5), 50 + 75 * (i // 5)) for i in range(25)], float)
        for number in range(120):
            picture = np.full((SIDE, SIDE), 200, np.uint8)
            for x, y in places:
                centre = (round(16 * x), round(16 * y))
                cv2.circle(picture, centre, round(8 * self.long), 90, -1, cv2.LINE_AA, 4)
            yield number, picture
            places += random.normal(0.0, self.speed_px_s, places.shape)


@dataclass
class Circles(Ellipses):
    """A film of 25 bodies that swim on circles, one turn in 1.5 s."""

    def __iter__(self):
        radius_px = self.speed_px_s * 1.5 / math.tau
        for number in range(120):
            picture = np.full((SIDE, SIDE), 200, np.uint8)
            turned = math.tau * self.seconds(number) / 1.5
            for i in range(25):
                angle = i + turned
                x = 50 + 75 * (i % 5) + radius_px * math.cos(angle)
                y = 50 + 75 * (i // 5) + radius_px * math.sin(angle)
                centre = (round(16 * x), round(16 * y))
                axes = (8 * self.long, 8 * self.wide)
                size = tuple(round(axis) for axis in axes)
                along = math.degrees(angle) + 90
                cv2.ellipse(picture, centre, size, along, 0, 360, 90, -1, cv2.LINE_AA, 4)
            yield number, picture


@pytest.mark.long
def test_swimmers_among_beads_are_followed_with_a_warning():
    """Regression: 36 swimming sperm were refused as beads, with a mean cosine of 0.463 for 0.5."""
    swimmers = Circles(12.0, 6.0, 30.0)
    beads = Beads(12.0, 12.0, 2.5)

    class SwimmersAndBeads(Ellipses):
        """A film whose left half shows swimmers, and the right one beads."""

        def __iter__(self):
            for (number, left), (_, right) in zip(swimmers, beads, strict=True):
                yield number, np.hstack([left[:, :160], right[:, 160:]])

    said = recognised(SwimmersAndBeads(0, 0, 0), 0.5).remarks
    assert any("most of what moves goes to and fro" in line for line in said)


@pytest.mark.long
def test_without_a_scale_it_follows_from_the_length_of_the_organism_and_is_said():
    film = swimming(EUGLENA, 1.5)
    recognition = recognised(film, None, EUGLENA)
    assert recognition.guessed and recognition.um_px == pytest.approx(1.5, rel=0.1)
    assert (
        "the scale is a guess" in recognition.remarks[0]
        and "euglena of 48 um" in recognition.remarks[0]
    )
    unknown = recognised(film, None)
    assert unknown.organism is TETRAHYMENA and "tetrahymena" in unknown.remarks[0]


def test_drifting_specks_do_not_outvote_the_cells_that_swim():
    cells = swimming(TETRAHYMENA, 2.3)
    specks = swimming(HELICAL_MICROROBOT, 2.3)

    class CellsAndSpecks(Ellipses):
        """A film of the cells and, turned upside down so that they do not meet, the specks."""

        def __iter__(self):
            for (number, of_cells), (_, of_specks) in zip(cells, specks, strict=True):
                yield number, np.minimum(of_cells, of_specks[::-1])

    mixed = CellsAndSpecks(0, 0, 0)
    assert recognised(mixed, 2.3).organism is TETRAHYMENA
