"""Tests of drawing a log's microscope images under the paths of its cells."""

import base64
import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from testkit.microscope.dish_films import film
from testkit.microscope.film_logs import write_film

from tetractl.log.read.reader import read_trial
from tetractl.report.trial_data import trial_data
from tetractl.verification.dish_pictures import SHOWN_SIDE_MAX_PX, DishPictures
from tetractl.view.figures.trajectory import trajectory_figure


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("film") / "trial-000.mcap"
    write_film(film(seed=52, side=384, cells=3, seconds=2.6), path)
    return read_trial(path)


@pytest.mark.long
def test_a_picture_lies_where_its_cells_were_measured(log):
    pictures = DishPictures(log)
    assert pictures.times_ns == [time_ns for time_ns, _ in log.pictures]
    low, right, up = pictures.corners
    place = np.linalg.inv(np.column_stack([right - low, up - low]))
    cells = 0
    for which, time_ns in enumerate(pictures.times_ns):
        grey = pictures.grey(which).astype(float)
        row = int(np.searchsorted(log.mocap_ns, time_ns))
        assert pictures.index_at(time_ns) == which
        for i in np.flatnonzero(log.valid[row]):
            across, upwards = place @ (log.mocap[row, i, :2] - low)
            column = int(across * grey.shape[1])
            line = int((1 - upwards) * grey.shape[0])
            assert abs(grey[line, column] - np.median(grey)) > 15
            cells += 1
    assert cells >= 2
    assert pictures.index_at(-1) == 0


def test_plot_and_page_have_the_picture(log):
    axes = trajectory_figure([log]).axes[0]
    (image,) = axes.get_images()
    corners = image.get_transform().transform([(0, 0), (1, 0), (0, 1)])
    corners_in_dish = axes.transData.inverted().transform(corners)
    assert corners_in_dish == pytest.approx(DishPictures(log).corners)
    data = trial_data(log, "trial-000.mcap")["dish"]
    assert len(data["jpeg"]) == len(log.pictures)
    first = Image.open(io.BytesIO(base64.b64decode(data["jpeg"][0])))
    assert max(first.size) <= SHOWN_SIDE_MAX_PX


def test_what_cannot_be_decoded_is_left_out(log):
    time_ns, good = log.pictures[0]
    hostile = ((1, b""), (2, b"\xff\xd8" + bytes(99)), (3, good[:60]), (time_ns, good))
    assert DishPictures(replace(log, pictures=hostile)).times_ns == [time_ns]
    none = replace(log, pictures=hostile[:2])
    assert trial_data(none, "trial-000.mcap")["dish"] is None
    assert trajectory_figure([none]).axes[0].get_images() == []
