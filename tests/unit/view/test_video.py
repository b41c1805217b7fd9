"""Tests of videos of a trial: their length, their motion, and formats that cannot be written."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from testkit.trials import cut_short, three_robots

from tetractl.core.errors import LogError, UsageError
from tetractl.view.video import HOLD_S, VideoFrames, check_file, write_video

pytestmark = pytest.mark.slow

WIDTH = 320
LASTS_S = 1.0  # of the trial


@pytest.fixture(scope="module")
def log():
    return cut_short(three_robots(), 5)


def milliseconds(path):
    """How long each picture of a video stands."""
    with Image.open(path) as video:
        durations_ms = []
        for frame in range(video.n_frames):
            video.seek(frame)
            video.load()
            durations_ms.append(video.info["duration"])
        return durations_ms


@pytest.mark.long
@pytest.mark.parametrize("ending", ["gif", "webp"])
def test_a_video_lasts_as_long_as_the_trial(tmp_path, log, ending):
    said = []
    path = tmp_path / f"video.{ending}"
    assert write_video(log, path, lambda *done: said.append(done), WIDTH) == 1
    total = sum(milliseconds(path)) / 1000
    assert total == pytest.approx(LASTS_S + HOLD_S, abs=0.1)
    with Image.open(path) as video:
        assert video.size[0] == WIDTH
        assert video.size[1] % 2 == 0
    assert said[0][0] == 1
    assert said[-1][0] == said[-1][1] == len(said)
    again = tmp_path / f"again.{ending}"
    write_video(log, again, width=WIDTH)
    assert again.read_bytes() == path.read_bytes()


def test_each_picture_shows_its_instant(log):
    frames = VideoFrames(log, WIDTH)
    start, later, start_again = (frames.at(t).copy() for t in (0.0, 0.9, 0.0))
    assert start.shape[1:] == (WIDTH, 3)
    assert np.array_equal(start, start_again)
    assert (start != later).any()
    still = VideoFrames(replace(log, steps=log.steps[:1]), WIDTH)
    assert still.at(0.0).any()


def test_a_long_trial_plays_faster(tmp_path, log, monkeypatch):
    monkeypatch.setattr("tetractl.view.video.LONGEST_S", 0.6)
    path = tmp_path / "video.gif"
    assert write_video(log, path, width=WIDTH) == 2
    assert sum(milliseconds(path)) / 1000 == pytest.approx(LASTS_S / 2 + HOLD_S, abs=0.1)


def test_an_mp4_needs_ffmpeg(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda program: None)
    with pytest.raises(UsageError, match="needs ffmpeg, which is not installed"):
        check_file(tmp_path / "video.mp4")


def test_a_video_that_fails_leaves_no_file(tmp_path, log, monkeypatch):
    def full(*args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Image.Image, "save", full)
    with pytest.raises(LogError, match="No space left"):
        write_video(log, tmp_path / "video.gif", width=WIDTH)
    assert list(tmp_path.iterdir()) == []
