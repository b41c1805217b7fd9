"""Tests that the printed tags of `tetractl lab markers` have the right place and size."""

import re

import numpy as np
import pytest
from testkit.cli import tetractl
from tetractl_microscope.apriltag.detect import Detector
from tetractl_microscope.markers import INCH_MM, PAPERS, Card, arranged, drawn

from tetractl.core.errors import UsageError

pytestmark = pytest.mark.slow
TAGS = [
    Card(0, 70.0, "a"),
    Card(1, 70.0, "b", angle=-2.0),
    Card(100, 150.0, "c", "x", angle=np.pi / 4),
    Card(586, 40.0, "d", angle=np.pi / 2),
    Card(2, 30.0, "e"),
]
DPI = 254  # ten pixels a millimetre


def grey(figure):
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., 0])


@pytest.mark.parametrize("paper", PAPERS)
def test_tags_have_their_true_size_and_are_read_upright(paper):
    sightings = {}
    for page in arranged(PAPERS[paper], TAGS):
        picture = grey(drawn(PAPERS[paper], page))
        for sighting in Detector().find(picture):
            sightings[sighting.tag] = sighting
            mm = (sighting.corners + 0.5) * INCH_MM / DPI
            x, y, card = next(placed for placed in page if placed[2].tag == sighting.tag)
            side = card.side_mm
            top_left = x + side / 8, PAPERS[paper][1] - (y + side * 9 / 8)
            assert mm[0] == pytest.approx(top_left, abs=0.15)
            assert mm[2] == pytest.approx(np.add(top_left, side), abs=0.15)
    assert sightings.keys() == {card.tag for card in TAGS}


@pytest.mark.parametrize("angle", [0.0, np.pi / 2, 2.0])
def test_an_arrow_beside_the_corner_points_to_the_front(angle):
    """It points to the right of a tag that is read upright: the top is on the robot's left."""
    (page,) = arranged(PAPERS["a4"], [Card(0, 80.0, "robot a", "front", angle)])
    figure = drawn(PAPERS["a4"], page)
    (arrow,) = [patch for patch in figure.axes[0].patches if type(patch).__name__ == "Polygon"]
    tip, left, right = arrow.get_xy()[:3]
    forward = tip - (left + right) / 2
    assert np.arctan2(forward[1], forward[0]) == pytest.approx(angle)
    assert figure.axes[0].texts[0].get_text() == "front"

    ((x, y, _),) = page
    left, top = x / INCH_MM * DPI, (PAPERS["a4"][1] - y - 100) / INCH_MM * DPI
    picture = grey(figure)[round(top) : round(top) + 1000, round(left) : round(left) + 1000]
    corner = picture[5:95, 770:995]  # above and beside the tag's top right corner
    assert corner.min() < 50
    picture[5:95, 770:995] = 255
    margins = [picture[5:95], picture[-95:-5], picture[:, 5:95].T, picture[:, -95:-5].T]
    assert [margin[:, 5:-5].min() for margin in margins] == [255] * 4


def test_a_tag_that_no_page_holds_is_refused():
    with pytest.raises(UsageError, match="tag 3: the tag of 200 mm"):
        list(arranged(PAPERS["a4"], [Card(3, 200.0, "x")]))


@pytest.mark.long
def test_a_new_spec_with_tags_is_printed_on_true_pages(tmp_path):
    tetractl(tmp_path, "init", "shelf", "--lab", "--camera", "apriltag", "--robots", "twist").ok()
    done = tetractl(tmp_path, "lab", "markers", "shelf.yaml", "-o", "tags.pdf").ok()
    assert done.stderr == "wrote 7 tags on 5 pages of a4 paper; print them without scaling\n"
    pages = re.findall(
        rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", (tmp_path / "tags.pdf").read_bytes()
    )
    assert len(pages) == 5
    size = [float(points) / 72 * INCH_MM for points in pages[0]]
    assert size == pytest.approx(PAPERS["a4"], abs=0.01)
    for words, why in (
        (["shelf.yaml", "--paper", "a5"], "--paper a5: must be a4, a3, letter"),
        (["shelf.yaml", "-o", "no/tags.pdf"], "the folder no does not exist"),
    ):
        wrong = tetractl(tmp_path, "lab", "markers", *words)
        assert (wrong.returncode, why in wrong.stderr) == (2, True)


def test_a_camera_without_tags_is_one_line(tmp_path):
    tetractl(tmp_path, "init", "first", "--lab").ok()
    done = tetractl(tmp_path, "lab", "markers", "first.yaml")
    assert done.returncode == 2
    assert done.stderr.startswith("error: first.yaml: lab.camera has type optitrack, which uses no")
