"""The film in a log: a change of a crop, of what is said of it or of a pose is noticed."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from support.dish_films import film
from support.film_logs import write_film
from support.mutate import rewrite
from support.tampering import noticed, tamperings

from tetractl.core.cell_film import cut
from tetractl.log.format import channels
from tetractl.log.format.crop_images import checksums
from tetractl.log.format.tetractl_pb2 import CellCrops
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.salvage import scan
from tetractl.replay.verify import verify

POSES = (channels.FRAMES, channels.TRANSFORMS)


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    path = tmp_path_factory.mktemp("film") / "trial-000.mcap"
    samples = write_film(film(seed=52, side=384, cells=3, seconds=1.6), path)
    return path, samples


def test_a_film_is_verified_by_the_code_that_found_it(shown):
    path, samples = shown
    assert sum(len(sample.film.crops) for sample in samples) > 40
    assert sum(sample.film.whole is not None for sample in samples) >= 1
    found = verify(path)
    assert found.problems == ()
    assert not any("film" in note for note in found.notes)


def test_changes_of_crops_and_poses_are_noticed(shown, tmp_path):
    log, missed = scan(shown[0]), Counter()
    tried = [
        one
        for one in tamperings(log, 1)
        if one.channel in channels.FILM or (one.channel in POSES and one.what != "bytes")
    ]
    assert len({one.what for one in tried}) > 30
    for number, one in enumerate(tried):
        if not noticed(log, one, tmp_path / f"{number}.mcap"):
            missed[one.channel, one.what] += 1
    assert missed == Counter()


def test_the_checksum_covers_which_robots_are_tracked(shown):
    seen = shown[1][0].observation
    other = replace(seen, valid=~seen.valid)
    assert checksums(CellCrops(), seen, ()) != checksums(CellCrops(), other, ())


def test_a_log_whose_film_was_taken_out_is_noticed(shown, tmp_path):
    log = scan(shown[0])
    records = [one for one in log.records if getattr(one, "topic", "") not in channels.FILM]
    bare = RawLog(log.path, records=records, channels=log.channels)
    found = verify(rewrite(bare, tmp_path / "bare.mcap", {}))
    assert [one.field for one in found.problems] == [channels.CELLS]


def test_a_crop_reaches_beyond_the_picture_with_zeros():
    picture = np.arange(1, 13, dtype=np.uint8).reshape(3, 4)
    assert cut(picture, 2, 1, 3).tolist() == [[7, 8, 0], [11, 12, 0], [0, 0, 0]]
    assert cut(picture, -1, -2, 3).tolist() == [[0, 0, 0], [0, 0, 0], [0, 1, 2]]
