"""What swims in a film's first pictures and cannot be followed is said."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from support.needs_opencv import cv2
from tetractl_microscope.film.first_pictures import examine_first
from tetractl_microscope.film.picture_times import PictureTimes
from tetractl_microscope.organisms import (
    HELICAL_MICROROBOT,
    PARAMECIUM,
    TETRAHYMENA,
    named,
)
from tetractl_microscope.registries import ORGANISMS

from tetractl.core.errors import TetractlError

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
            for x, y, angle in self.bodies(number):
                centre = (round(16 * x), round(16 * y))
                size = (round(8 * self.long), round(8 * self.wide))
                turned = math.degrees(angle)
                cv2.ellipse(picture, centre, size, turned, 0, 360, 90, -1, cv2.LINE_AA, 4)
            yield number, picture

    def bodies(self, number):
        """The places [px] and axes [rad] of the bodies in a picture."""
        way = self.speed_px_s * self.seconds(number)
        for i in range(COUNT):
            angle = 0.3 * i - 0.8
            yield 70 + way * math.cos(angle), 60 + 55 * i + way * math.sin(angle), angle

    def seconds(self, number):
        return number / self.rate_hz


def remarks_of(*film):
    """Return the lines for the user of a film, its scale and perhaps its organism."""
    _, remarks = examine_first(*film)
    return remarks


def swimming(kind, um_px):
    """A film of the organism's usual size and speed."""
    long, wide = kind.body_um
    speed = math.sqrt(math.prod(kind.speed_um_s))
    return Ellipses(long / um_px, wide / um_px, speed / um_px)


@pytest.mark.parametrize("name", ORGANISMS.names())
def test_an_organism_that_is_named_has_its_size_and_speed(name):
    kind = named(name)
    um_px = kind.body_um[1] / 9
    (said,) = remarks_of(swimming(kind, um_px), um_px, kind)
    start, _, counts = said.partition(": ")
    like, of, swimmers, *_ = counts.split()
    assert (start, of) == (f"followed as {name}", "of")
    assert 2 * int(like) > int(swimmers) > 2


@pytest.mark.long
def test_other_swimmers_than_those_chosen_are_counted_and_named():
    film = swimming(PARAMECIUM, 6.0)
    _, said, coarse = remarks_of(film, 6.0)
    assert "tetrahymena is 4.4 px wide at 6 um/px; 8 px or more are needed" in coarse
    assert "objects that move have not the size and speed of tetrahymena" in said
    assert said.endswith("--organism paramecium follows them, if they swim and do not drift")
    assert len(remarks_of(film, 6.0, PARAMECIUM)) == 1


@pytest.mark.long
def test_of_what_swims_and_is_like_no_organism_the_scale_is_asked():
    worms = Ellipses(40.0, 12.0, 60.0)  # 400 um long, 120 um wide
    said = remarks_of(worms, 10.0)[1]
    assert said.endswith("no known organism is like that: is --scale right?")


def test_nothing_that_swims_is_no_warning():
    still = Ellipses(20.0, 8.0, 0.0)
    (said,) = remarks_of(still, 2.0)
    assert said.startswith("followed as tetrahymena: 0 of 0 objects")


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

    def bodies(self, number):
        radius_px = self.speed_px_s * 1.5 / math.tau
        for i in range(25):
            angle = i + math.tau * self.seconds(number) / 1.5
            x = 50 + 75 * (i % 5) + radius_px * math.cos(angle)
            y = 50 + 75 * (i // 5) + radius_px * math.sin(angle)
            yield x, y, angle + math.pi / 2


def test_cells_that_turn_while_they_are_looked_at_swim_all_the_same():
    film = Circles(22.0, 11.0, 100.0)
    assert len(remarks_of(film, 2.3)) == 1


@pytest.mark.long
def test_beads_that_go_to_and_fro_do_not_swim():
    beads = Beads(12.0, 12.0, 1.5)
    with pytest.raises(TetractlError, match="goes to and fro, as beads do: nothing swims"):
        examine_first(beads, 0.5)
    said = remarks_of(beads, 0.5, HELICAL_MICROROBOT)
    assert any("nothing swims" in line for line in said)


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

    said = remarks_of(SwimmersAndBeads(0, 0, 0), 0.5)
    assert any("most of what moves goes to and fro" in line for line in said)


def test_pictures_too_rare_to_tell_cells_apart_are_said():
    film = swimming(TETRAHYMENA, 2.3)
    film.rate_hz = 5.0
    _, said = remarks_of(film, 2.3)
    assert "5 pictures a second are too few" in said and said.endswith("film at 8 or more")
    film.rate_hz = 10.0
    assert len(remarks_of(film, 2.3)) == 1
