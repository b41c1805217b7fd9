"""Tests of which images of a log can be shown, and where they lie."""

import io
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from tetractl.verification.dish_pictures import LOGGED_SIDE_MAX_PX, SHOWN_SIDE_MAX_PX, DishPictures


class Camera:
    """A microscope of 0.5 um per pixel, whose images are shifted and turned by a quarter."""

    um_px = 0.5

    def placed(self, x_um, y_um, metres):
        per_um = 1e-6 / metres
        return 7.0 - y_um * per_um, 3.0 + x_um * per_um


def jpeg(width=40, height=20, level=120, kind="JPEG"):
    file = io.BytesIO()
    Image.new("L", (width, height), level).save(file, kind)
    return file.getvalue()


def log_of(pictures, camera=None, metres=1e-6):
    """A log with these images, each with its time."""
    return SimpleNamespace(
        experiment=SimpleNamespace(plant=SimpleNamespace(microscope=camera or Camera())),
        pictures=tuple(pictures),
        start=SimpleNamespace(setup=SimpleNamespace(metres=metres)),
    )


def test_images_have_their_times_and_their_grey_levels_from_above():
    upper = np.zeros((20, 40), np.uint8)
    upper[:10] = 255
    file = io.BytesIO()
    Image.fromarray(upper).save(file, "JPEG", quality=95)
    pictures = DishPictures(log_of([(5, file.getvalue()), (9, jpeg(level=200))]))
    assert pictures.times_ns == [5, 9]
    assert pictures.grey(0).shape == (20, 40)
    assert pictures.grey(0)[:8].min() > 240
    assert pictures.grey(0)[12:].max() < 15
    assert abs(int(pictures.grey(1)[3, 3]) - 200) < 4


@pytest.mark.parametrize(("metres", "unit_um"), [(1e-6, 1), (1e-3, 1000)])
def test_the_corners_are_those_of_the_first_readable_image_in_the_specs_unit(metres, unit_um):
    log = log_of([(1, b"torn"), (2, jpeg(40, 20)), (3, jpeg(80, 80))], metres=metres)
    corners = DishPictures(log).corners * unit_um
    x, y = 7.0 * unit_um, 3.0 * unit_um
    assert corners == pytest.approx(np.array([(x, y), (x, y + 20), (x - 10, y)]))


def test_an_image_that_cannot_be_read_is_left_out():
    too_wide = jpeg(LOGGED_SIDE_MAX_PX + 1, 1)
    good = jpeg(LOGGED_SIDE_MAX_PX, 1)
    torn = [(1, b""), (2, jpeg()[:60]), (3, jpeg(kind="PNG")), (4, too_wide)]
    assert DishPictures(log_of(torn)).times_ns == []
    assert DishPictures(log_of([*torn, (5, good)])).times_ns == [5]


def test_a_log_without_a_microscope_has_no_images():
    log = log_of([(1, jpeg())])
    log.experiment.plant.microscope = None
    pictures = DishPictures(log)
    assert pictures.times_ns == []
    assert pictures.index_at(9) is None


@pytest.mark.parametrize(
    ("count", "shown"),
    [(None, 10), (20, 10), (10, 10), (9, 5), (5, 5), (4, 4), (3, 3), (1, 1)],
)
def test_at_most_so_many_images_are_shown_at_even_distances_from_the_first(count, shown):
    log = log_of([(time, jpeg(8, 8)) for time in range(10)])
    times = DishPictures(log, count).times_ns
    assert len(times) == shown
    assert times[0] == 0
    assert len(set(np.diff(times))) <= 1


@pytest.mark.parametrize(
    ("when", "which"), [(-5, 0), (9, 0), (10, 0), (11, 0), (19, 0), (20, 1), (30, 2), (99, 2)]
)
def test_the_image_of_a_time_is_the_last_one_taken_until_then(when, which):
    log = log_of([(time, jpeg(8, 8)) for time in (10, 20, 30)])
    assert DishPictures(log).index_at(when) == which


@pytest.mark.parametrize(("size", "longer"), [((1500, 900), SHOWN_SIDE_MAX_PX), ((300, 500), 500)])
def test_large_images_are_reduced_and_keep_their_shape_and_small_ones_stay(size, longer):
    pictures = DishPictures(log_of([(1, jpeg(*size))]))
    height, width = pictures.grey(0).shape
    assert max(height, width) == pytest.approx(longer, abs=1)
    assert width / height == pytest.approx(size[0] / size[1], rel=0.01)
    shown = Image.open(io.BytesIO(pictures.jpeg(0)))
    assert (shown.format, shown.size) == ("JPEG", (width, height))
