"""Tests of blobs and cells in synthetic images against the truth."""

import math
from dataclasses import replace

import numpy as np
import pytest
from testkit.microscope.dish_films import film, followed, scored
from tetractl_emulator.pictures.dish.picture import PictureLook
from tetractl_microscope.cells.cell import BodySize, PathBlob
from tetractl_microscope.cells.cell_tracks import CellTrack
from tetractl_microscope.cells.detect_cells import BLOBS_MAX, BlobFinder
from tetractl_microscope.cells.specks import Speck
from tetractl_microscope.cells.tracking import CellTracker
from tetractl_microscope.organisms import TETRAHYMENA
from tetractl_microscope.tracks.field_file import no_field

pytestmark = pytest.mark.slow

SIZE = BodySize(50.0, 25.0)
BLACK_OR_WHITE = 255 * np.random.default_rng(2).integers(0, 2, (20, 24))


@pytest.mark.long
@pytest.mark.parametrize("field_known", [True, False])
def test_poses_of_swimming_cells(field_known):
    synthetic = film(seed=1, side=512, cells=5)
    score = scored(synthetic, followed(synthetic, field_known))
    assert score.found > 0.98
    assert np.median(score.off_um) < 1.6
    assert np.median(np.abs(score.axis_off)) < 0.03
    assert np.median(np.abs(score.turned)) < 0.1


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
    tracked = followed(synthetic, False, slow, every=2, slower=8.0)
    assert scored(synthetic, tracked).found > 0.9


def test_a_knock_moves_all_places_of_a_track():
    path = [PathBlob(1.0, 10.0, 20.0, 0.5, 50.0, 25.0)]
    moved_path = [PathBlob(1.0, 13.0, 16.0, 0.5, 50.0, 25.0)]
    start = np.array((8.0, 20.0))
    cell = CellTrack(1, 0, SIZE, last_um=np.array([10.0, 20.0]), path=path, start_um=start)
    cell.move_by(3.0, -4.0)
    assert cell.path == moved_path
    assert cell.start_um.tolist() == [11.0, 16.0]
    assert cell.last_um.tolist() == [13.0, 16.0]
    speck = Speck(2, path)
    speck.move_by(3.0, -4.0)
    assert speck.path == moved_path


@pytest.mark.long
def test_numbers_are_kept_through_crossings():
    synthetic = film(seed=12, side=512, cells=4, seconds=4.0)
    score = scored(synthetic, followed(synthetic))
    assert score.found > 0.98
    assert score.kept > 0.97


@pytest.mark.long
@pytest.mark.parametrize("bright", [False, True])
def test_the_polarity_is_found_and_specks_are_no_cells(bright):
    drawn_look = PictureLook.sample(np.random.default_rng(6), 384, 2.3)
    specks = tuple(speck for speck in drawn_look.specks if speck.drift == (0.0, 0.0))
    look = {"bright": bright, "light": 50.0 if bright else 160.0, "specks": specks}
    synthetic = film(seed=6, side=384, look=look, cells=3, crossings=0.0)
    tracked = followed(synthetic)
    score = scored(synthetic, tracked)
    assert tracked.tracker.finder.bright is bright
    assert score.found > 0.94
    assert score.false < 0.1


@pytest.mark.long
def test_a_resting_cell_is_not_lost_in_the_background():
    synthetic = film(seed=7, side=512, cells=4, seconds=6.0, events=True, crossings=0.0)
    resting = np.flatnonzero((synthetic.times > 0.42 * 6) & (synthetic.times < 0.58 * 6))[10:]
    if not synthetic.in_view[resting, 3].all():
        pytest.fail("the film does not show what it is for")
    seen = followed(synthetic).seen
    is_shown = [
        any(math.dist((cell.x, cell.y), synthetic.body[k, 3, :2]) < 15 for cell in seen[k])
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
        tracked = tracker.track_image(picture, k / 30, no_field)
        assert len(tracker.finder.find_blobs(absurd)) <= BLOBS_MAX
        assert all(np.isfinite((c.x, c.y, c.heading)).all() for c in tracked)
        if 20 < k < 30:
            assert tracked == []


def test_light_that_changes_makes_no_blobs():
    flat = np.full((128, 128), 120, np.uint8)
    finder = BlobFinder(20, 2000)
    finder.learn([flat] * 3)
    for level in (60, 100, 150, 200):
        assert finder.find_blobs(np.full((128, 128), level, np.uint8)) == []
        assert finder.light.gain == pytest.approx(level / 120, rel=0.02)
