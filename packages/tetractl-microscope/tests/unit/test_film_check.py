"""The film in a log: a change of a crop, of what is said of it or of a pose is noticed."""

import random
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from support.dish_films import film
from support.film_logs import write_film
from support.mutate import rewrite
from support.tampering import noticed, tamperings
from tetractl_microscope.cells.detect_cells import blobs_of

from tetractl.core.cell_film import cut
from tetractl.log.format import channels
from tetractl.log.format.crop_images import checksums, encode_film
from tetractl.log.format.tetractl_pb2 import CellCrops, Run
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


def test_a_crop_of_another_blob_is_noticed_though_its_checksum_fits(shown, tmp_path):
    """The picture within the crop is changed, and everything that repeats it is made to fit."""
    log, samples = scan(shown[0]), shown[1]
    rng, begin = random.Random(3), log.run.start_unix_ns
    pairs = zip(log.by_topic[channels.CELLS], log.by_topic[channels.CROPS], strict=True)
    for number, ((cells, crops), sample) in enumerate(
        rng.sample([one for one in zip(pairs, samples, strict=True) if len(one[1].film.crops)], 12)
    ):
        seen = sample.film
        crops_changed = seen.crops.copy()
        left, top = seen.corners[0].tolist()
        blobs = blobs_of(seen.crops[0], seen.limits, (left, top))
        body = min(blobs, key=lambda blob: np.hypot(*(blob.x, blob.y) - seen.blobs[0, :2])).pixels
        column, row = (body[rng.randrange(len(body))] - (left, top)).astype(int)
        crops_changed[0, row, column] += 1 if crops_changed[0, row, column] < 255 else -1
        forged = replace(seen, crops=crops_changed)
        made = encode_film(forged, sample.observation, begin)
        new = {
            cells: cells._replace(data=made[channels.CELLS].SerializeToString()),
            crops: crops._replace(data=made[channels.CROPS].SerializeToString()),
        }
        found = verify(rewrite(log, tmp_path / f"{number}.mcap", new))
        assert [one.message for one in found.problems] == [
            f"frame {sample.observation.frame}: "
            "the blob found in crop 0 differs from the logged blob"
        ]


def test_another_opencv_is_not_comparable_and_no_failure(shown, tmp_path):
    log = scan(shown[0])
    entries = {}
    for entry in log.by_topic[channels.RUN]:
        run = Run.FromString(entry.data)
        next(fact for fact in run.facts if fact.key == "opencv").value = "4.0.1"
        entries[entry] = entry._replace(data=run.SerializeToString())
    path = rewrite(log, tmp_path / "other.mcap", entries)
    found = verify(path)
    assert found.ok
    (note,) = [note for note in found.notes if "film" in note]
    assert "not comparable: written with OpenCV 4.0.1" in note


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
