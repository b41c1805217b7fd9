"""Blobs and cells of synthetic pictures against their truth."""

import math
from dataclasses import replace

import numpy as np
import pytest
from support.dish_films import Reel, axis_errors, film, followed, scored
from tetractl_microscope.cells.cell import BodySize, PathBlob
from tetractl_microscope.cells.cell_tracks import CellTrack
from tetractl_microscope.cells.detect_cells import BLOBS, BlobFinder
from tetractl_microscope.cells.specks import Speck
from tetractl_microscope.cells.tracking import CellTracker
from tetractl_microscope.film.field_file import no_field
from tetractl_microscope.film.follow import follow
from tetractl_microscope.film.picture_times import PictureTimes
from tetractl_microscope.organisms import TETRAHYMENA

pytestmark = pytest.mark.slow

SIZE = BodySize(50.0, 25.0)
BLACK_OR_WHITE = 255 * np.random.default_rng(2).integers(0, 2, (20, 24))


@pytest.mark.long
@pytest.mark.parametrize("field_known", [True, False])
def test_poses_of_swimming_cells(field_known):
    synthetic = film(seed=1, side=512, cells=5)
    tracked = followed(synthetic, field_known)
    score = scored(synthetic, tracked)
    assert score.f1 > 0.98
    assert math.sqrt(score.place2 / score.near) < 1.6
    assert np.median(axis_errors(synthetic, tracked)) < 0.03
    assert math.sqrt(score.heading2 / score.headings) < 0.1


@pytest.mark.long
def test_a_slow_organism_is_followed_at_a_low_rate():
    """A film at 30 Hz is played eight times more slowly, every second picture of it."""
    synthetic = film(seed=44, side=512, cells=8, crossings=False)
    slow = replace(
        TETRAHYMENA,
        name="slow",
        speed_um_s=tuple(speed / 8 for speed in TETRAHYMENA.speed_um_s),
        helix_hz=tuple(turns / 8 for turns in TETRAHYMENA.helix_hz),
    )
    every_second = list(synthetic.pictures())[::2]
    reel = Reel(synthetic, every_second, PictureTimes(30.0 / 8 / 2))
    tracked = follow(reel, synthetic.look.um_px, None, slow)
    assert scored(synthetic, tracked, every=2).f1 > 0.96


def test_a_knock_moves_all_places_of_a_track():
    path = [PathBlob(1.0, 10.0, 20.0, 0.5, 50.0, 25.0)]
    moved_path = [PathBlob(1.0, 13.0, 16.0, 0.5, 50.0, 25.0)]
    start = np.array((8.0, 20.0))
    cell = CellTrack(1, 0, SIZE, last=np.array([10.0, 20.0]), path=path, start=start)
    cell.shift(3.0, -4.0)
    assert cell.path == moved_path
    assert cell.start.tolist() == [11.0, 16.0]
    assert cell.last.tolist() == [13.0, 16.0]
    speck = Speck(2, path)
    speck.shift(3.0, -4.0)
    assert speck.path == moved_path


@pytest.mark.long
def test_numbers_are_kept_through_crossings():
    synthetic = film(seed=12, side=512, cells=4, seconds=4.0)
    score = scored(synthetic, followed(synthetic))
    assert score.f1 > 0.98
    assert score.named > 0.97 * score.found


@pytest.mark.long
@pytest.mark.parametrize("bright", [False, True])
def test_the_polarity_is_found_and_specks_are_no_cells(bright):
    look = {"bright": bright, "light": 50.0 if bright else 160.0}
    synthetic = film(seed=6, side=384, look=look, cells=3, crossings=0.0)
    tracked = followed(synthetic)
    assert tracked.bright is bright
    assert scored(synthetic, tracked).f1 > 0.97


@pytest.mark.long
def test_a_resting_cell_is_not_lost_in_the_background():
    synthetic = film(seed=7, side=512, cells=4, seconds=6.0, events=True, crossings=0.0)
    resting = np.flatnonzero((synthetic.times > 0.42 * 6) & (synthetic.times < 0.58 * 6))[10:]
    if not synthetic.in_view[resting, 3].all():
        pytest.fail("the film does not show what it is for")
    places = {}
    for path in followed(synthetic).paths:
        for k, cell in zip(path.frames.tolist(), path.sightings, strict=True):
            places.setdefault(k, []).append((cell.x, cell.y))
    is_shown = [
        any(math.dist(place, synthetic.body[k, 3, :2]) < 15 for place in places.get(k, []))
        for k in resting.tolist()
    ]
    assert np.mean(is_shown) > 0.95


ABSURD = {
    "black": np.zeros((200, 240)),
    "saturated": np.full((200, 240), 255),
    "noise": np.random.default_rng(1).integers(0, 256, (200, 240)),
    "checkerboard": 255 * (np.indices((200, 240)).sum(axis=0) % 2),
    "blobs": np.kron(BLACK_OR_WHITE, np.ones((10, 10))),
}


@pytest.mark.parametrize("name", ABSURD)
def test_absurd_pictures_have_few_blobs_and_no_cells(name):
    absurd = ABSURD[name].astype(np.uint8)
    synthetic = film(seed=1, side=240, cells=2, seconds=1.0)
    pictures = [picture[:200] for picture in synthetic.pictures()]
    tracker = CellTracker(2.3, field_known=False)
    tracker.finder.learn(pictures)
    for k, picture in enumerate([*pictures[:10], *[absurd] * 20, *pictures[10:20]]):
        tracked = tracker.see(picture, k / 30, no_field)
        assert len(tracker.finder.find(absurd)) <= BLOBS
        assert all(np.isfinite((c.x, c.y, c.heading)).all() for c in tracked)
        if 20 < k < 30:
            assert tracked == []


def test_light_that_changes_makes_no_blobs():
    flat = np.full((128, 128), 120, np.uint8)
    finder = BlobFinder(20, 2000)
    finder.learn([flat] * 3)
    for level in (60, 100, 150, 200):
        assert finder.find(np.full((128, 128), level, np.uint8)) == []
        assert finder.light.gain == pytest.approx(level / 120, rel=0.02)


def drawn(cells, size):
    """Return a picture of ellipses: column, row, half length and half width [px]."""
    rows, columns = np.indices(size)
    level = np.full(size, 120.0)
    for column, row, long, wide in cells:
        from_middle = np.square((columns - column) / long) + np.square((rows - row) / wide)
        level = np.where(from_middle < 1, 60.0, level)
    return level.astype(np.uint8)


def test_what_returns_from_the_edge_where_a_cell_left_may_be_another_cell():
    def picture(k):  # a cell leaves the picture where another one enters
        return drawn([(380 - abs(300 - 6 * k), 100.0, 12.0, 6.0)], (200, 380))

    tracker = CellTracker(2.3, field_known=True, splits=True)
    tracker.finder.learn([picture(10 * k) for k in range(10)])
    before = {c.identity for k in range(40) for c in tracker.see(picture(k), k / 30, no_field)}
    looked = [tracker.see(picture(k), k / 30, no_field) for k in range(40, 90)]
    after = {cell.identity for cells in looked[-10:] for cell in cells}
    assert len(before) == len(after) == 1 and before.isdisjoint(after)
