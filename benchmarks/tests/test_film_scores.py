"""The films of benchmarks/films.py can be read, and its scores count what they say."""

import subprocess
import sys

import numpy as np
from filmworld.rows import table
from filmworld.scores import Shown, score_film
from filmworld.taken_out import RULES
from filmworld.truth import FilmTruth, write_film
from support.needs_opencv import cv2
from support.paths import ROOT

PICTURES = 90
RATE = 30.0


def two_cells():
    """Two cells that swim to the right, 200 um apart."""
    times = np.arange(PICTURES) / RATE
    x = np.column_stack([100 + 100 * times, 100 + 100 * times])
    y = np.full_like(x, (200.0, 400.0))
    none = np.zeros_like(x)
    return FilmTruth(
        times=times,
        x=x,
        y=y,
        heading=none,
        speed=none + 100.0,
        resting=none.astype(bool),
        a=np.array([4.0, 0.0]),
        parent=np.array([-1, -1]),
        turns=np.zeros((1, 2)),
        recorded=np.zeros(1),
        um_px=2.0,
        side_px=400,
    )


def shown(truth, name, **changed):
    """What a tracker says that finds both cells, with names (K, 2)."""
    frame = np.repeat(np.arange(PICTURES), 2)
    rows = {
        "x": truth.x.ravel(),
        "y": truth.y.ravel(),
        "heading": truth.heading.ravel(),
        "sure": np.ones(2 * PICTURES, bool),
    }
    return Shown(frame, np.asarray(name).ravel(), **(rows | changed))


def test_a_perfect_tracker_has_a_perfect_score():
    truth = two_cells()
    said = shown(truth, np.tile((1, 2), (PICTURES, 1)))
    said.numbers = {
        1: {"speed": (99.0, 101.0), "a": (3.0, 5.0)},
        2: {"speed": (80.0, 90.0), "a": (0.1, 0.2)},
    }
    score = score_film("film", truth, said)
    assert (score.f1, score.place2, score.named, score.wrong) == (1.0, 0.0, 2 * PICTURES, [])
    assert (score.a, score.speed, score.strangers) == ([True], [True, False], [True])
    assert dict(table([score]))["95 % interval of the speed holds"].startswith("1 of 2")


def test_names_that_are_exchanged_for_good_are_two_wrong_names():
    names = np.tile((1, 2), (PICTURES, 1))
    names[40:] = names[40:, ::-1]
    truth = two_cells()
    score = score_film("film", truth, shown(truth, names))
    assert score.wrong == [True, True] and (score.right, score.covered) == (80, 80)
    assert score.named == 2 * 50


def test_a_name_exchanged_for_less_than_half_a_second_does_not_last():
    names = np.tile((1, 2), (PICTURES, 1))
    names[40:50] = names[40:50, ::-1]
    truth = two_cells()
    assert score_film("film", truth, shown(truth, names)).wrong == []


def test_a_new_name_is_not_wrong():
    names = np.tile((1, 2), (PICTURES, 1))
    names[40:, 0] = 3
    truth = two_cells()
    assert score_film("film", truth, shown(truth, names)).wrong == []


def test_what_is_farther_than_half_a_body_is_missed_and_extra():
    truth = two_cells()
    far = truth.x.copy()
    far[:, 1] += 40
    names = np.tile((1, 2), (PICTURES, 1))
    score = score_film("film", truth, shown(truth, names, x=far.ravel()))
    assert (score.found, score.missed, score.extra) == (PICTURES, PICTURES, PICTURES)


def test_a_film_is_read_at_its_rate_and_quality(tmp_path):
    truth = two_cells()
    random = np.random.default_rng(0)
    pictures = [random.integers(100, 140, (400, 400)).astype(np.uint8) for _ in range(PICTURES)]
    write_film(tmp_path / "film", truth, iter(pictures), 90)
    reader = cv2.VideoCapture(str(tmp_path / "film" / "film.avi"))
    assert reader.get(cv2.CAP_PROP_FPS) == RATE
    for picture in pictures:
        read, decoded = reader.read()
        assert read
        coded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 90])[1]
        expected = cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE)
        assert np.abs(decoded[..., 0].astype(int) - expected).max() <= 3
    assert not reader.read()[0]
    stored = FilmTruth.load(tmp_path / "film" / "truth.npz")
    np.testing.assert_array_equal(stored.x, truth.x)
    assert stored.view.all() == truth.view.all()


def test_the_second_renderer_shares_no_code_with_tetractl():
    code = "import sys, filmworld.second; print([m for m in sys.modules if 'tetractl' in m])"
    root = ROOT / "benchmarks"
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stderr


def test_each_rule_that_can_be_taken_out_is_there():
    for replaced in RULES.values():
        for owner, name, _ in replaced:
            assert hasattr(owner, name), f"{owner.__name__} has no {name}"
