"""Tests of fitting speed, helix and response to the track of a cell whose motion is known."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm
from tetractl_microscope.cells.field_record import FieldRecord
from tetractl_microscope.cells.helix import A_ERROR, SPEED_ERROR
from tetractl_microscope.organisms import find_organism
from tetractl_microscope.tracks.fit_track import IMAGE_RATE_MIN_HZ, CellPath, fit_tracks

TETRAHYMENA = find_organism("tetrahymena")
HZ = 25.0
FINE = 20
"""Steps of the motion from one image to the next."""
CHANGES = np.arange(0.0, 20.0, 1.5)
FIELD = FieldRecord(CHANGES, np.random.default_rng(2).uniform(-3.0, 3.0, len(CHANGES)))


def swum(
    a=4.0, bias=0.0, speed=300.0, helix_um=8.0, helix_hz=2.5, noise_um=0.3, seconds=15.0, number=1
):
    """The track of a cell on a helix that turns by the field as dh/dt = a sin(u - h - bias).

    Turning rate and speed may be functions of the time.
    """
    step_s = 1 / (HZ * FINE)
    times = np.arange(0.0, seconds, step_s)
    a_at = a if callable(a) else lambda t: a
    speed_at = speed if callable(speed) else lambda t: speed
    heading = 0.3
    headings = []
    for t, u in zip(times.tolist(), np.angle(FIELD.field_at(times)).tolist(), strict=True):
        headings.append(heading)
        heading += a_at(t) * math.sin(u - heading - bias) * step_s
    way = np.cumsum([speed_at(t) * step_s for t in times] * np.exp(1j * np.array(headings)))
    aside = helix_um * np.cos(math.tau * helix_hz * times)
    places = (way + 1j * aside * np.exp(1j * np.array(headings)))[::FINE]
    noise = np.random.default_rng(number).normal(0.0, noise_um, (2, len(places)))
    return CellPath(
        number, times[::FINE], np.column_stack([places.real + noise[0], places.imag + noise[1]])
    )


PATH = swum()


def fitted(*paths, field=FIELD, organism=TETRAHYMENA, hz=HZ):
    return fit_tracks(paths or (PATH,), organism, field, 1 / hz)


def width(interval):
    return interval.high - interval.low


@pytest.mark.parametrize(
    ("a", "bias", "speed", "helix_um", "helix_hz"),
    [
        (4.0, 0.0, 300.0, 8.0, 2.5),
        (2.5, 0.3, 450.0, 12.0, 1.8),
        (5.0, -0.4, 350.0, 6.0, 3.0),
        (3.0, 0.2, 200.0, 10.0, 2.2),
    ],
)
def test_what_a_cell_did_is_within_the_intervals(a, bias, speed, helix_um, helix_hz):
    (cell,) = fitted(swum(a, bias, speed, helix_um, helix_hz))
    for interval, truth in ((cell.a_rad_s, a), (cell.bias_rad, bias), (cell.speed_um_s, speed)):
        assert interval.low < truth < interval.high
        assert interval.value == pytest.approx((interval.low + interval.high) / 2)
    assert cell.a_rad_s.value == pytest.approx(a, rel=0.06)
    assert cell.bias_rad.value == pytest.approx(bias, abs=0.06)
    assert cell.speed_um_s.value == pytest.approx(speed, rel=0.03)
    assert cell.helix_hz == pytest.approx(helix_hz, rel=0.04)
    assert cell.helix_um == pytest.approx(helix_um, rel=0.15)
    assert cell.path_um == pytest.approx(speed * (15.0 - 1 / HZ), rel=0.03)
    assert cell.magnetised is True


def test_intervals_are_as_wide_as_the_stated_errors_at_least_and_not_absurdly_wider():
    (cell,) = fitted()
    least = 2 * norm.ppf(0.975)
    a = width(cell.a_rad_s)
    assert least * A_ERROR * cell.a_rad_s.value < a < 6 * least * A_ERROR * cell.a_rad_s.value
    speed = width(cell.speed_um_s)
    error = SPEED_ERROR * cell.speed_um_s.value
    assert least * error < speed < 3 * least * error
    assert 0.002 < width(cell.bias_rad) < 0.3


def test_places_and_times_may_begin_anywhere():
    later = FieldRecord(FIELD.times + 5000.0, FIELD.angles)
    moved = CellPath(1, PATH.times + 5000.0, PATH.places + np.array([1e4, -3e3]))
    (here,) = fitted()
    (there,) = fitted(moved, field=later)
    assert there.since_s == here.since_s + 5000.0
    for name in ("a_rad_s", "bias_rad", "speed_um_s"):
        one, other = getattr(here, name), getattr(there, name)
        assert (other.value, width(other)) == pytest.approx(
            (one.value, width(one)), rel=5e-3, abs=1e-3
        )
    assert there.helix_hz == pytest.approx(here.helix_hz, rel=1e-3)


def test_a_rotated_dish_changes_nothing_and_a_mirrored_one_the_sign_of_the_bias():
    path = swum(bias=0.3)
    (here,) = fitted(path)
    turn = 1.1
    cos, sin = math.cos(turn), math.sin(turn)
    rotated = replace(path, places=path.places @ np.array([[cos, sin], [-sin, cos]]))
    (there,) = fitted(rotated, field=FieldRecord(FIELD.times, FIELD.angles + turn))
    assert there.a_rad_s.value == pytest.approx(here.a_rad_s.value, rel=1e-3)
    assert there.bias_rad.value == pytest.approx(here.bias_rad.value, abs=1e-3)
    mirrored = replace(path, places=path.places * (1.0, -1.0))
    (image,) = fitted(mirrored, field=FieldRecord(FIELD.times, -FIELD.angles))
    assert image.a_rad_s.value == pytest.approx(here.a_rad_s.value, rel=1e-2)
    assert image.bias_rad.value == pytest.approx(-here.bias_rad.value, abs=1e-2)


def test_a_stronger_field_turns_the_same_cell_faster():
    """a is that of the reference field, relative to which the file states strengths."""
    (usual,) = fitted()
    (weak,) = fitted(field=FieldRecord(FIELD.times, FIELD.angles, np.full(len(CHANGES), 2.0)))
    assert weak.a_rad_s.value == pytest.approx(usual.a_rad_s.value / 2, rel=0.01)


@pytest.mark.parametrize("a", [0.0, 0.02])
def test_a_cell_without_a_magnet_does_not_respond(a):
    straight = swum(a=a, helix_um=8.0)
    (cell,) = fitted(straight)
    assert cell.magnetised is False
    assert abs(cell.a_rad_s.value) < 0.3
    assert cell.speed_um_s.low < 300.0 < cell.speed_um_s.high


def test_without_a_field_there_is_a_speed_and_no_response():
    (cell,) = fitted(swum(a=0.0), field=None)
    assert cell.a_rad_s is cell.bias_rad is cell.magnetised is None
    assert cell.speed_um_s.low < 300.0 < cell.speed_um_s.high
    assert cell.helix_hz == pytest.approx(2.5, rel=0.04)


def test_the_sway_is_that_of_a_body_along_its_path_on_the_helix():
    for helix_um in (4.0, 8.0):
        for a, field in ((0.0, None), (4.0, FIELD)):
            (cell,) = fitted(swum(a=a, helix_um=helix_um), field=field)
            assert cell.sway_rad == pytest.approx(math.tau * 2.5 * helix_um / 300.0, rel=0.4)


def test_a_speed_that_varies_has_a_deviation():
    (steady,) = fitted()
    (varying,) = fitted(swum(speed=lambda t: 300 + 80 * math.sin(math.tau * t / 5)))
    assert steady.speed_sd_um_s < 10
    assert varying.speed_sd_um_s == pytest.approx(80 / math.sqrt(2), rel=0.2)
    assert varying.speed_um_s.low < 300.0 < varying.speed_um_s.high


def test_counts_and_times_are_those_of_the_track():
    path = CellPath(12, PATH.times[10:60] + 2.0, PATH.places[10:60])
    (cell,) = fitted(path, field=None)
    assert (cell.cell, cell.pictures) == (12, 50)
    assert cell.since_s == pytest.approx(2.4)
    assert cell.duration_s == pytest.approx(50 / HZ)
    assert path.rows[0].tolist() == [path.times[0], *path.places[0]]


@pytest.mark.parametrize(("images", "has_fit"), [(1, False), (6, False), (7, True)])
def test_a_track_of_few_images_has_a_length_and_no_speed_along_a_helix(images, has_fit):
    path = CellPath(1, PATH.times[:images], PATH.places[:images])
    if images == 1:
        images = 2
        path = CellPath(1, PATH.times[:2], PATH.places[:2])
    (cell,) = fitted(path)
    assert (cell.speed_um_s is not None) == (cell.a_rad_s is not None) == has_fit
    length = np.linalg.norm(np.diff(path.places, axis=0), axis=1).sum()
    if not has_fit:
        assert cell.path_um == pytest.approx(length)
        assert cell.magnetised is None and math.isnan(cell.helix_hz)
    assert cell.vsl_um_s > 0


def test_rare_images_have_a_length_and_no_speed_along_a_helix():
    rare = CellPath(1, PATH.times[::5], PATH.places[::5])
    (cell,) = fitted(rare, hz=HZ / 5)
    assert cell.speed_um_s is None and cell.a_rad_s is None
    assert cell.duration_s == pytest.approx(len(rare.times) * 5 / HZ)
    assert fitted(PATH, hz=IMAGE_RATE_MIN_HZ - 0.01)[0].speed_um_s is None
    assert fitted(PATH, hz=IMAGE_RATE_MIN_HZ + 0.01)[0].speed_um_s is not None


def test_cells_of_a_table_are_fitted_each_for_itself():
    slow = swum(a=2.5, speed=200.0, number=2)
    lone = [fitted(PATH)[0], fitted(slow)[0]]
    short = CellPath(3, PATH.times[:5], PATH.places[:5])
    first, none, second = fitted(PATH, short, slow)
    assert none.a_rad_s is None
    for together, alone in zip((first, second), lone, strict=True):
        assert together.a_rad_s.value == alone.a_rad_s.value
        assert together.speed_um_s.value == alone.speed_um_s.value
        assert width(together.a_rad_s) == pytest.approx(width(alone.a_rad_s), rel=0.5)


def changing(t):
    """A turning rate that the model does not know."""
    return 2.0 if int(t / 3) % 2 else 6.0


def test_a_cell_whose_response_changes_has_wider_intervals_and_so_have_others_of_its_table():
    changed = swum(a=changing, number=4)
    (steady,) = fitted()
    (alone,) = fitted(changed)
    assert width(alone.a_rad_s) > 2 * width(steady.a_rad_s)
    assert width(alone.bias_rad) > 2 * width(steady.bias_rad)
    assert width(alone.speed_um_s) > 1.1 * width(steady.speed_um_s)
    beside, *_ = fitted(PATH, *(replace(changed, number=k) for k in range(4)))
    assert width(beside.a_rad_s) > 1.1 * width(steady.a_rad_s)
    assert width(beside.a_rad_s) < 2 * width(steady.a_rad_s)
    assert beside.a_rad_s.value == steady.a_rad_s.value


def test_a_cell_that_turns_to_the_field_and_away_in_turn_is_not_taken_for_a_magnet():
    (cell,) = fitted(swum(a=lambda t: -2.0 if int(t / 3) % 2 else 3.5))
    assert cell.magnetised is False


def test_more_noise_of_places_widens_the_intervals():
    (exact,) = fitted(swum(noise_um=0.0))
    (noisy,) = fitted(swum(noise_um=10.0))
    assert exact.a_rad_s.low < 4.0 < exact.a_rad_s.high
    assert noisy.a_rad_s.low < 4.0 < noisy.a_rad_s.high
    assert width(noisy.bias_rad) > 1.3 * width(exact.bias_rad)


def test_a_record_has_value_and_ends_of_each_interval():
    (cell,) = fitted()
    items = cell.items()
    for name in ("a_rad_s", "bias_rad", "speed_um_s"):
        interval = getattr(cell, name)
        assert items[name] == {"value": interval.value, "ci95": [interval.low, interval.high]}
    assert items["pictures"] == len(PATH.times)
    (cell,) = fitted(field=None)
    assert cell.items()["a_rad_s"] is None
