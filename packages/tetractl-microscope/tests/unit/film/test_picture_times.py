"""The times of a film's pictures are those that its source states, and what is dropped is said."""

import struct

import numpy as np
import pytest
import tifffile
from support.matroska import matroska
from support.needs_opencv import cv2
from tetractl_microscope.film.kinematics import vsl_um_s
from tetractl_microscope.film.picture_names import TIMES_FILE, places_of, require_one_film
from tetractl_microscope.film.picture_times import PictureTimes, increasing
from tetractl_microscope.film.pictures import open_film

from tetractl.core.errors import UsageError

pytestmark = pytest.mark.slow


def drawn(count, side=48):
    """Pictures that all differ."""
    return np.random.default_rng(count).integers(0, 256, (count, side, side + 16), np.uint8)


def seconds_of(film):
    """The times of the pictures that can be read."""
    return [film.seconds(number) for number, _ in film]


@pytest.mark.parametrize(
    ("stated", "times", "said"),
    [
        ([5.0, 5.1, 5.2, 5.3], [0.0, 0.1, 0.2, 0.3], []),
        ([0.0, 0.1, 0.2, 0.2, 0.4], [0.0, 0.1, 0.2, 0.3, 0.4], ["1 picture states the time of"]),
        ([0.0, None, 0.2, 0.3], [0.0, 0.1, 0.2, 0.3], ["1 picture states no time"]),
        ([None, 0.1, 0.2, None], [0.0, 0.1, 0.2, 0.3], ["2 pictures state no time"]),
        ([*range(10), 0.0, 11.0], list(range(12)), ["1 picture states a time that is not in"]),
        ([0.0, 0.0, 1.0, 1.0, 2.0, 2.0], [0.0, 0.5, 1.0, 1.5, 2.0, 2.5], ["3 pictures state the"]),
        ([*range(10), 99.0, *range(11, 20)], None, ["9 of 20 times of its pictures are not in"]),
        ([0.4, 0.3, 0.2, 0.1], None, ["3 of 4 times of its pictures are not in order"]),
        ([0.0, 0.0, 0.0], None, ["all state the same time"]),
        ([0.0, None, None], None, ["state no time but the first"]),
        ([None, None], None, []),
    ],
)
def test_a_time_that_cannot_be_right_leaves_the_others(stated, times, said):
    seconds, lines = increasing(stated)
    assert seconds == (times if times is None else pytest.approx(times))
    assert len(lines) == len(said)
    assert all(text in line for line, text in zip(lines, said, strict=True))


def test_a_containers_clock_is_rounded_to_an_even_rate_but_not_an_uneven_one():
    even = PictureTimes(30.0, [])
    for number in range(60):
        even.note(number, round(number / 30, 3))  # Matroska's clock has steps of 1 ms
    assert even.even and even.rate_hz == 30.0 and even.uneven_line() is None
    assert even.seconds(59) == 59 / 30 and even.duration(0, 59) == 2.0
    slower = PictureTimes(27.0, [])
    for number in range(31):
        slower.note(number, number / 30 if number <= 15 else 0.5 + (number - 15) / 15)
    assert slower.seconds(30) == pytest.approx(1.5) and slower.rate_hz == pytest.approx(20.0)
    assert "0.0333 to 0.0667 s apart" in (slower.uneven_line() or "")


@pytest.mark.parametrize("planned", [{}, {"TimeIncrement": 1.0, "TimeIncrementUnit": "s"}])
@pytest.mark.parametrize(
    ("unit", "factor"), [("s", 1.0), ("ms", 1e3), ("µs", 1e6), ("min", 1 / 60)]
)
def test_measured_times_are_used_though_one_is_repeated(tmp_path, planned, unit, factor):
    times = np.arange(20) * 0.1 + 3.0
    times[7] = times[6]
    delta = {"DeltaT": (times * factor).tolist(), "DeltaTUnit": [unit] * 20}
    path = tmp_path / "film.ome.tif"
    tifffile.imwrite(path, drawn(20), ome=True, metadata={"axes": "TYX", **planned, "Plane": delta})
    film = open_film(path)
    assert seconds_of(film) == pytest.approx(np.arange(20) / 10)
    assert any("1 picture states the time of the picture before" in r for r in film.remarks)
    assert any("planned at 1 Hz" in remark for remark in film.remarks) == bool(planned)


@pytest.mark.parametrize(
    ("names", "places"),
    [
        (["p1.png", "p2.png", "p4.png"], [0, 1, 3]),
        (["t0005_c1.png", "t0010_c1.png", "t0015_c1.png"], None),
        (["t0.png", "t5.png", "t10.png", "t20.png"], [0, 1, 2, 4]),
        (["1700000000033.png", "1700000000067.png", "1700000000100.png"], None),
        ([f"{n}.png" for n in (58, 59, 60, 64, 65)], [0, 1, 2, 6, 7]),
        (["a1.tif", "a2.tiff", "a3.tif", "a4.TIF"], None),
    ],
)
def test_the_places_of_pictures_are_those_of_the_numbers_in_their_names(names, places, tmp_path):
    require_one_film(tmp_path, names)
    assert places_of(tmp_path, names, []) == places


@pytest.mark.parametrize(
    "names",
    [
        [f"t{k}_c{c}.png" for k in range(5) for c in (0, 1)],
        [f"img_{k}_{c}.png" for k in range(5) for c in ("BF", "GFP")],
        [f"img_{k}.{c}" for k in range(5) for c in ("jpg", "png")],
        ["0_dark.png", *(f"a{k}.png" for k in range(9))],
        ["a0.jpg", *(f"a{k}.png" for k in range(1, 9))],
        ["left.png", "right.png"],
    ],
)
def test_pictures_of_two_kinds_are_not_one_film(names, tmp_path):
    """Regression: they were pictures one after the other, so that a film took twice its time."""
    for name in names:
        cv2.imwrite(str(tmp_path / name), drawn(1)[0])
    with pytest.raises(UsageError, match="of one film, and one after the other") as error:
        open_film(tmp_path, 20.0)
    assert names[0] in str(error.value) and names[1] in str(error.value)
    times = "".join(f"{k / 20}\n" for k in range(len(names)))
    (tmp_path / TIMES_FILE).write_text("time_s\n" + times)
    assert open_film(tmp_path).timing.even


@pytest.mark.parametrize(
    "times",
    [
        np.concatenate([np.arange(10) / 15, 2 / 3 + np.arange(10) / 30]),  # the rate doubles
        np.concatenate([np.arange(10) / 25, 3 + np.arange(10) / 25]),  # a pause
        np.cumsum(np.random.default_rng(3).uniform(0.02, 0.2, 20)),
    ],
)
@pytest.mark.parametrize("begins", [0.0, 7.0])
def test_times_of_a_video_are_those_of_its_pictures(tmp_path, times, begins):
    path = matroska(tmp_path / "film.mkv", drawn(len(times)), times + begins)
    film = open_film(path)
    assert seconds_of(film) == pytest.approx(times - times[0], abs=2e-3)
    assert film.rate_hz == pytest.approx((len(times) - 1) / np.ptp(times), rel=1e-2)
    assert (film.time_line() or "").startswith("times are those of the film")
    assert seconds_of(film) == pytest.approx(times - times[0], abs=2e-3)  # read again
    at_20_hz = open_film(path, 20.0)
    assert seconds_of(at_20_hz) == pytest.approx(np.arange(20) / 20)
    line = at_20_hz.time_line() or ""
    assert line.startswith("warning: --rate replaces the times of the film")


@pytest.mark.parametrize("rate", [30.0, 29.97, 12.5])
def test_a_video_of_an_even_rate_has_exactly_even_times(tmp_path, rate):
    times = np.arange(40) / rate + 3.0
    film = open_film(matroska(tmp_path / "film.mkv", drawn(40), times))
    assert seconds_of(film) == [number / film.rate_hz for number in range(40)]
    assert film.rate_hz == pytest.approx(rate, rel=1e-3) and film.time_line() is None


def test_velocities_do_not_depend_on_the_rate_of_the_pictures():
    """A circle at a constant speed of 100 pi um/s, filmed at 30, then at 15 pictures a second."""
    times = np.concatenate([np.arange(60) / 30, 2 + np.arange(31) / 15])
    angle = np.pi * times
    around = 100 * np.column_stack([np.cos(angle), np.sin(angle)])
    half_a_turn_a_second_um_s = 200
    assert vsl_um_s(times, around) == pytest.approx(half_a_turn_a_second_um_s, rel=0.01)


@pytest.mark.parametrize("many", [False, True])
@pytest.mark.parametrize(
    ("code", "name"), [(50000, "ZSTD"), (34712, "JPEG2000"), (33003, "APERIO")]
)
def test_a_compression_that_is_not_read_is_named_with_the_remedy(tmp_path, many, code, name):
    path = tmp_path / "film.tif"
    with tifffile.TiffWriter(path) as tif:
        for picture in drawn(2):
            tif.write(picture, photometric="minisblack", metadata=None, contiguous=False)
    data = path.read_bytes()
    with tifffile.TiffFile(path) as tif:
        places = [page.tags["Compression"].valueoffset for page in tif.pages]
    for place in places:
        data = data[:place] + struct.pack("<H", code) + data[place + 2 :]
    path.write_bytes(data)
    if many:
        (tmp_path / "many").mkdir()
        for k in range(2):
            (tmp_path / "many" / f"{k}.tif").write_bytes(data)
        path = tmp_path / "many"
    with pytest.raises(
        UsageError, match=f"compressed by {name}.*, which needs imagecodecs"
    ) as error:
        open_film(path, 10.0)
    assert "pip install imagecodecs" in error.value.hint


def test_numbers_that_have_started_again_are_refused(tmp_path):
    """Regression: the first half of a film came after the second."""
    before = [f"p{k}.png" for k in range(9990, 10000)]
    after = [f"p{k:04d}.png" for k in range(10)]
    with pytest.raises(UsageError, match=r"9980 pictures are missing, .* p0009\.png: have the num"):
        places_of(tmp_path, [*after, *before], [])
    assert places_of(tmp_path, after, []) is None


def test_a_rate_that_no_film_has_is_not_used_in_silence(tmp_path):
    """Regression: "states no rate; ... taken at 0.01 Hz, by their times, which are used"."""
    (tmp_path / "film").mkdir()
    for k in range(4):
        cv2.imwrite(str(tmp_path / "film" / f"{k}.png"), drawn(1)[0])
    (tmp_path / "film" / TIMES_FILE).write_text("time_s\n0\n50\n100\n150\n")
    with pytest.raises(UsageError, match=r"for --rate, 0\.02, is not used: not in 0\.1 to 2000"):
        open_film(tmp_path / "film")
