"""Films as microscopes write them: pictures, scale, rate and times are those that were written."""

import io
import pickle
import signal
import subprocess
import sys
import tomllib
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from support.film_containers import (
    CONTAINERS,
    RATE_HZ,
    UM_PX,
    folder,
    imagej,
    stack,
)
from support.hostile_films import BOMBS, outcome
from support.needs_opencv import cv2, video
from tetractl_microscope.film.film_source import (
    FilmSource,
    grey_levels,
    grey_scale,
    nd2_film,
)
from tetractl_microscope.film.pictures import open_film

from tetractl.core.errors import TetractlError, UsageError

pytestmark = pytest.mark.slow

PROJECT = Path(__file__).parents[3] / "pyproject.toml"
COUNT = 6
SLOW = {"many large pictures", "deflate bomb"}


def made(count=COUNT, side=64):
    """Pictures that all differ."""
    return np.random.default_rng(count).integers(0, 256, (count, side, side + 16), np.uint8)


@pytest.mark.parametrize("name", CONTAINERS)
def test_every_container_gives_the_pictures_that_were_written(tmp_path, name):
    write, has_scale, has_rate = CONTAINERS[name]
    pictures = made()
    film = open_film(
        write(tmp_path / name, pictures),
        None if has_rate else RATE_HZ,
        None if has_scale else UM_PX,
    )
    assert np.array_equal([picture for _, picture in film], pictures)
    assert film.damaged == 0
    assert (film.rate_hz, film.um_px) == pytest.approx((RATE_HZ, UM_PX))
    assert film.seconds(COUNT - 1) == pytest.approx((COUNT - 1) / RATE_HZ)
    assert film.remarks == []


@pytest.mark.long
def test_a_value_of_the_user_beats_the_tags_and_a_difference_is_said(tmp_path):
    film = open_film(imagej(tmp_path / "a.tif", made()), 25.0, 2.0)
    assert (film.rate_hz, film.um_px) == (25.0, 2.0)
    assert film.remarks == [
        "--rate 25 is used; the film states 30",
        "--scale 2 is used; the film states 2.3",
    ]
    assert film.seconds(1) == pytest.approx(1 / 25)
    assert open_film(imagej(tmp_path / "b.tif", made()), RATE_HZ, UM_PX).remarks == []


@pytest.mark.long
def test_a_folder_may_have_a_file_of_times(tmp_path):
    path = folder(tmp_path / "film", made(3))
    file = tmp_path / "film" / "times.csv"
    file.write_text("time_s\n5.0\n5.5\n5.6\n")
    film = open_film(path)
    assert [film.seconds(number) for number, _ in film] == [5.0, 5.5, 5.6]
    assert film.rate_hz == pytest.approx(2 / 0.6)
    for text, says in (
        ("time_s\n1\n2\n", "has 2 times for 3 pictures"),
        ("time_s\n1\n1\n2\n", "line 3: the time is not after that before"),
        ("t\n1\n2\n3\n", "column t states no unit"),
    ):
        file.write_text(text)
        with pytest.raises(UsageError, match=says):
            open_film(path)


def test_of_channels_the_first_is_read_and_that_is_said(tmp_path):
    pictures = made(8)
    meta = {"axes": "TCYX", "finterval": 0.1}
    film = open_film(
        stack(
            tmp_path / "a.tif", pictures.reshape(4, 2, *pictures.shape[1:]),
            imagej=True, metadata=meta,
        )
    )  # fmt: skip
    assert np.array_equal([p for _, p in film], pictures[::2])
    assert film.remarks == ["the first of 2 channels is read"]


def test_what_has_no_height_and_width_is_no_picture():
    shapes = [(8,), (0, 8), (8, 0), (2, 2, 2, 2), (8, 9), (8, 9, 3)]
    source = FilmSource(lambda index: np.zeros(shapes[index], np.uint8), len(shapes))
    assert [pixels is None for pixels in source.pictures()] == [True] * 4 + [False] * 2


def test_films_of_any_depth_use_their_own_range():
    dim = np.random.default_rng(3).normal(30_000, 60, (4, 64, 64)).astype(np.uint16)
    low, step = grey_scale(dim)
    grey = grey_levels(dim[0], low, step)
    assert np.ptp(grey) > 150
    signed = dim.astype(np.float32) - 30_000
    signed[0, 0, 0] = np.nan
    assert np.ptp(grey_levels(signed[1], *grey_scale(signed))) > 150
    hot = (made(8).astype(np.uint16) << 4) % 4096
    hot[0, 0, 0] = 65535  # a defective pixel
    assert np.ptp(grey_levels(hot[1], *grey_scale(hot))) > 190
    flat = np.full((1, 8, 8), 700, np.uint16)
    assert np.all(grey_levels(flat[0], *grey_scale(flat)) == 175)


def test_nd2_is_read_through_its_library(tmp_path, monkeypatch):
    """No library writes ND2."""

    class ND2File:
        """Stands in for `nd2.ND2File` 0.12: 3 pictures, each of 2 planes and 2 channels."""

        sizes = {"T": 3, "Z": 2, "C": 2, "Y": 4, "X": 5}  # noqa: RUF012

        def __init__(self, path):
            pass

        def read_frame(self, index):
            return np.full((2, 4, 5), [[[index]], [[99]]], np.uint16)

        def voxel_size(self):
            return SimpleNamespace(x=0.65, y=0.65, z=1.0)

        def frame_metadata(self, index):
            time = SimpleNamespace(relativeTimeMs=200.0 + 25.0 * index)
            return SimpleNamespace(channels=[SimpleNamespace(time=time)])

    module = ModuleType("nd2")
    module.ND2File = ND2File
    monkeypatch.setitem(sys.modules, "nd2", module)
    path = tmp_path / "film.nd2"
    path.write_bytes(bytes(3 * 64))
    film = nd2_film(path)
    assert [int(pixels[0, 0]) for pixels in film.pictures()] == [0, 2, 4]
    assert film.um_px == 0.65 and film.times == pytest.approx([0, 0.05, 0.1])
    assert film.remarks == ["the first of 2 slices is read", "the first of 2 channels is read"]
    path.write_bytes(bytes(3 * 64 - 1))
    with pytest.raises(UsageError, match=r"cannot have 3 pictures in 191 bytes"):
        nd2_film(path)


def test_a_missing_library_is_named_with_its_extra(tmp_path):
    path = tmp_path / "film.nd2"
    path.write_bytes(b"\xda\xce\xbe\n" + bytes(100))
    with pytest.raises(TetractlError) as error:
        open_film(path)
    if "cannot be read, since nd2 is not installed" in str(error.value):
        assert error.value.hint == "pip install './packages/tetractl-microscope[films]'"
        extras = tomllib.loads(PROJECT.read_text())["project"]["optional-dependencies"]
        assert any(name.startswith("nd2") for name in extras["films"])


@pytest.mark.long
def test_a_picture_is_measured_before_it_is_decoded(tmp_path):
    large = np.zeros((4097, 4096), np.uint8)
    for name in ("1.png", "1.tif"):
        path = tmp_path / name[2:]
        path.mkdir()
        cv2.imwrite(str(path / name), large)
        with pytest.raises(UsageError, match="at most 4096 x 4096 px are read"):
            open_film(path, 30.0)


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(set(BOMBS) - SLOW))
def test_a_hostile_film_ends_with_one_line(tmp_path, name):
    """Those that take seconds are left out."""
    BOMBS[name](tmp_path / "film")
    how, said, _ = outcome(tmp_path, tmp_path / "film")
    assert how in ("ended with 1", "ended with 2"), said
    lines = [line for line in said.splitlines() if "is used; the film" not in line]
    assert len([line for line in lines if not line.startswith("hint: ")]) == 1


@pytest.mark.long
def test_the_decoder_has_no_more_memory_than_it_says(tmp_path):
    """400 MB of zeros in a strip of 0.4 MB are a picture that cannot be read."""
    path = tmp_path / "film.tif"
    BOMBS["deflate bomb"](path)
    words = [sys.executable, "-P", "-m", "tetractl_microscope.film.decode", str(path)]
    with io.BytesIO(subprocess.run(words, capture_output=True, check=True).stdout) as written:
        stated, error = pickle.load(written)
        picture = pickle.load(written)
    assert stated["count"] == 1
    assert error is None
    assert picture == (None, None)


HELD = """
import sys
from pathlib import Path
from tetractl_microscope.film import decode
from tetractl_microscope.film.film_source import FilmSource
def endless(source, index):
    while True: pass
FilmSource._picture = endless
decode.PATIENCE_S = 0.5  # ten times what the decoder needs of the processor for a small film
decode.main(Path(sys.argv[1]), sys.stdout.buffer)
"""
"""A decoder with little patience that never has read a picture."""


@pytest.mark.long
def test_a_picture_that_takes_the_processor_without_end_ends_the_decoder(tmp_path):
    path = video(tmp_path / "film.avi", made(2))
    words = [sys.executable, "-P", "-c", HELD, str(path)]
    assert subprocess.run(words, capture_output=True).returncode == -signal.SIGPROF
