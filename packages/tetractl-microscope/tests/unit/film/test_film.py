"""Films: their pictures, what is found of each cell, and how sure that is."""

from types import SimpleNamespace

import numpy as np
import pytest
from support.dish_films import Reel, film, followed, record, who
from support.film_rows import recorded, seen_cell
from support.needs_opencv import cv2
from tetractl_microscope.cells.field_record import FieldRecord
from tetractl_microscope.cells.kernels.helix_steps import HEADING
from tetractl_microscope.film.field_file import clock_remarks, read_field
from tetractl_microscope.film.film_tables import as_items
from tetractl_microscope.film.fit_cell import _Fit, _Measured, fit_cells
from tetractl_microscope.film.follow import follow
from tetractl_microscope.film.kinematics import vsl_um_s
from tetractl_microscope.film.pictures import open_film
from tetractl_microscope.film.who import CellPath, TrackRow, _sure
from tetractl_microscope.organisms import TETRAHYMENA

from tetractl.core.errors import UsageError

pytestmark = pytest.mark.slow


@pytest.mark.long
def test_a_speeds_and_biases_are_within_their_intervals():
    inside = []
    found_count = 0
    for seed in (31, 33):
        synthetic = film(seed=seed, side=512, cells=5, strangers=1, seconds=5.0, crossings=False)
        fitted, cells = fit_cells(followed(synthetic), record(synthetic))
        for path, cell in zip(fitted.paths, cells, strict=True):
            i = who(synthetic, path)
            if cell.a_rad_s is None or cell.duration_s < 3 or i is None:
                continue
            found_count += 1
            truth = synthetic.cells.a[i], synthetic.cells.speed[i]
            pairs = zip((cell.a_rad_s, cell.speed_um_s), truth, strict=True)
            inside += [interval.low < value < interval.high for interval, value in pairs]
            assert cell.speed_um_s.high - cell.speed_um_s.value < 0.05 * truth[1]
            assert cell.magnetised is bool(truth[0] > 0)
            assert cell.path_um == pytest.approx(truth[1] * cell.duration_s, rel=0.05)
    assert found_count >= 4
    assert np.mean(inside) >= 0.85


@pytest.mark.parametrize(("seed", "turned"), [(0, 1.5), (1, 2.1), (7, 2.1), (8, 1.5)])
def test_the_heading_is_right_again_after_a_cell_has_backed_away_and_turned(seed, turned):
    random = np.random.default_rng(seed)
    times = np.arange(160) / 30
    begins_s = 160 / 60
    backs = (times > begins_s) & (times < begins_s + 0.5)
    heading = random.normal(0, 0.07 / 30**0.5, 160).cumsum()
    heading += np.where(times > begins_s + 0.25, turned, 0.0)
    way = np.where(backs, -150.0, 330.0) / 30 * np.exp(1j * heading)
    turn = 6 * np.pi * times  # of a helix of 8 um
    places = 1000 * (1 + 1j) + way.cumsum() + 8j * np.cos(turn) * np.exp(1j * heading)
    places += random.normal(0, 0.5, (160, 2)) @ (1, 1j)
    swing = np.arctan(0.8 * 8 * 6 * np.pi * np.sin(turn) / 330)
    axes = heading + swing + random.normal(0, 0.02, 160)
    gathered = [
        seen_cell(1, x, y, 1, measured=(x, y, axis, 0.86, 0.86, 0.04))
        for x, y, axis in np.column_stack([places.real, places.imag, axes]).tolist()
    ]
    path = CellPath(1, times, np.arange(160), tuple(gathered))
    dish = SimpleNamespace(organism=TETRAHYMENA, size=(2000, 2000), um_px=2.3)
    fit = _Fit.of(_Measured.of(path, dish, None), np.ones(3))
    off = np.angle(np.exp(1j * (fit.states[:, HEADING] - heading)))
    assert (np.abs(off) > 0.8).sum() < 17  # it backs in 15 pictures


@pytest.mark.long
@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        (range(60), []),
        ([k for k in range(60) if k % 8 != 5], ["pictures are lost"]),
        ([k - 1 if k % 8 == 5 else k for k in range(60)], ["pictures are doubled"]),
    ],
)
def test_pictures_that_are_lost_or_doubled_are_said(numbers, said):
    synthetic = film(seed=31, side=512, cells=5, crossings=False, seconds=2.0)
    pictures = list(synthetic.pictures())
    tracked = follow(Reel(synthetic, [pictures[k] for k in numbers]), 2.3, None, TETRAHYMENA)
    lines = [line for line in tracked.remarks if "pictures are" in line]
    assert len(lines) == len(said)
    for line, words in zip(lines, said, strict=True):
        assert words in line


@pytest.mark.long
def test_without_a_field_there_is_no_a():
    synthetic = film(seed=34, side=512, cells=3, crossings=False)
    tracked = followed(synthetic, field_known=False)
    tracked, cells = fit_cells(tracked, None)
    turning = {(cell.a_rad_s, cell.bias_rad, cell.magnetised) for cell in cells}
    assert turning == {(None, None, None)}
    assert as_items("reel", tracked, cells)["cells"][0]["a_rad_s"] is None


def test_pictures_of_a_folder_come_by_number_and_bad_ones_are_counted(tmp_path):
    for k in (2, 10, 1):
        cv2.imwrite(str(tmp_path / f"p{k}.png"), np.full((80, 90), k, np.uint8))
    (tmp_path / "p3.png").write_bytes(b"no picture")
    cv2.imwrite(str(tmp_path / "p4.png"), np.zeros((10, 10), np.uint8))
    (tmp_path / "notes.txt").write_text("not a picture")
    film_ = open_film(tmp_path, 30.0)
    assert [(k, int(picture[0, 0])) for k, picture in film_] == [(0, 1), (1, 2), (4, 10)]
    assert film_.damaged == 2


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "OpenCV cannot read this film"),
        (b"RIFF" + bytes(100), "OpenCV cannot read this film"),
        (bytes(range(256)) * 40, "OpenCV cannot read this film"),
        (b"\xff\xd8\xff\xe0 cut", "OpenCV cannot read this film"),
        (b'<?xml version="1.0"?><TrackMate/>', "is XML"),
        (b"PK\3\4rest", "is a zip archive"),
        (b"ZISRAWFILE", "is a film of Zeiss"),
    ],
)
def test_what_is_no_film_is_one_clear_error_that_says_what_it_is(tmp_path, content, says):
    """Regression: OpenCV could not read a table, and it was to be converted to AVI."""
    path = tmp_path / "film.avi"
    path.write_bytes(content)
    with pytest.raises(UsageError, match=says):
        open_film(path)


def test_the_field_is_that_of_the_last_row_before(tmp_path):
    path = tmp_path / "field.csv"
    path.write_text("time_s,direction_rad,strength\n1.0,0,1\n2.0,1.5707963,0.5\n")
    field = read_field(path)
    assert field.pieces(0.0, 0.5) == [(0.5, 0.0, 0.0)]
    cut = np.array(field.pieces(0.5, 2.5))
    assert cut == pytest.approx(np.array([(0.5, 0, 0), (1.0, 1, 0), (0.5, 0, 0.5)]), abs=1e-6)
    assert read_field(path, upside_down=True).pieces(2.0, 2.5)[-1][2] == pytest.approx(-0.5)


@pytest.mark.parametrize(
    "text",
    [
        "time_s, direction_rad\n1.5, 1.5707963\n",
        "time_ms;direction_deg\n1500;90,0\n",
        "Time (s)\tDirection [deg]\n1,5\t90\n",
        "# made by hand\ntime_s direction_rad\n1.5 1.5707963\n",
    ],
)
def test_a_field_is_read_however_it_is_written(tmp_path, text):
    path = tmp_path / "field.csv"
    path.write_text(text)
    field = read_field(path)
    assert field.times.tolist() == [1.5]
    (field_then,) = field.at(np.array([2.0]))
    assert field_then == pytest.approx(1j, abs=1e-6)


@pytest.mark.parametrize(
    ("times", "says"),
    [
        ((1764000000.0, 1764000001.5), "no time is among those of film.mp4, 0 to 12 s"),
        ((20.0, 30.0), "no time is among those of film.mp4"),
    ],
)
def test_a_field_of_another_clock_is_refused(times, says):
    field = FieldRecord(np.array(times), np.zeros(len(times)))
    with pytest.raises(UsageError, match=says):
        clock_remarks(field, "field.csv", "film.mp4", 0.0, 12.0)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a,b\n1,2\n", "has no column time_s: its columns are a, b"),
        ("time_s,direction_rad\n1,north\n", "line 2: direction_rad: 'north' is not a number"),
        ("time_s,direction_rad\n1,nan\n", "line 2: direction_rad: states no number"),
        ("time_s,direction_rad\n0,0\n1,90\n", "line 3: direction_rad: 90 is more than a whole"),
        ("time,direction_rad\n1,0\n", "column time states no unit"),
        ("time_s,direction_rad\n2,0\n1,0\n", "line 3: the time is earlier"),
        ("time_s,direction_rad\n", "has no rows"),
        ("time_s,direction_rad,strength\n0,0,1\n1,0,-1e8\n", "line 3: strength: -1e\\+08 is too"),
    ],
)
def test_a_wrong_field_is_one_clear_error(tmp_path, text, says):
    path = tmp_path / "field.csv"
    path.write_text(text)
    with pytest.raises(UsageError, match=says):
        read_field(path)


def test_the_velocity_along_the_straight_line_is_that_of_parts_of_a_second():
    times = np.arange(91) / 30.0
    wave = 20 * np.sin(2 * np.pi * 2.0 * times)  # um; whole turns in each part
    assert vsl_um_s(times, np.column_stack([300 * times, wave])) == pytest.approx(300)
    angle = np.pi * times  # half a turn of 100 um in each part
    around = 100 * np.column_stack([np.cos(angle), np.sin(angle)])
    assert vsl_um_s(times, around) == pytest.approx(200)
    assert vsl_um_s(times[:2], np.array([(0.0, 0.0), (3.0, 4.0)])) == pytest.approx(150)
    assert vsl_um_s(times[:1], np.zeros((1, 2))) is None


@pytest.mark.parametrize(
    ("likely", "large", "tracks", "sure"),
    [
        ([1.0, 1.0, 0.4, 0.4, 1.0, 1.0], [], "777777", [True] * 6),  # certain before and after
        ([1.0, 1.0, 1.0, 0.97, 0.97, 0.97], [], "777777", [True] * 3 + [False] * 3),
        ([0.5, 0.5, 1.0, 1.0, 1.0, 1.0], [], "777777", [True] * 6),
        ([0.9] * 6, [], "777777", [False] * 6),
        ([1.0] * 6, [2, 3], "777777", [True] * 6),  # in its blob may be something unknown
        ([1.0] * 6, [4, 5], "777777", [True] * 4 + [False] * 2),  # the same at the end
        ([1.0] * 6, [], "777788", [True] * 4 + [False] * 2),  # lost and found again
    ],
)
def test_a_name_is_sure_unless_another_cell_may_have_taken_it(likely, large, tracks, sure):
    cells = [
        seen_cell(3, 9.0, 9.0, track, p, merged=k in large, measured=(0.0,) * 6)
        for k, (p, track) in enumerate(zip(likely, tracks, strict=True))
    ]
    assert _sure([TrackRow(k, cell, 3, cell.probability) for k, cell in enumerate(cells)]) == sure


def test_what_is_seen_too_briefly_stays_or_drifts_is_no_cell():
    def cells_in(k):
        places = {
            "moves": (4.0 * k, 0),
            "stays": (5, 5),
            "drifts": (k, 50),
            "jumps": (4.0 * k + 9 * (k % 2), 90),
            "fades": (4.0 * k, 30),
            "brief": (90.0 * k, 9),
        }
        cells = [
            seen_cell(name, x, y, track, has_blob=name != "fades" or k % 5 < 3)
            for track, (name, (x, y)) in enumerate(places.items())
        ]
        return {cell.track: cell for cell in cells[: 6 if k < 3 else 5]}

    pictures = [cells_in(k) for k in range(90)]
    paths = recorded(pictures, np.arange(90) / 30.0).paths(TETRAHYMENA)
    assert [path.identity for path in paths] == ["moves"]


def test_a_cell_needs_no_way_beyond_its_length():
    """Regression: cells of 50 um that swam less than 60 um, as many that turn, were not shown."""
    pictures = [{5: seen_cell(1, 80.0 * k / 30, 0.0, 5)} for k in range(15)]
    paths = recorded(pictures, np.arange(15) / 30.0).paths(TETRAHYMENA)
    assert [path.identity for path in paths] == [1]
