"""Tests that the printed tags of `tetractl lab markers` have the right place and size."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit.cli import tetractl
from tetractl_microscope.apriltag.detect import Detector
from tetractl_microscope.markers import (
    INCH_MM,
    LABEL_HEIGHT_MM,
    MARGIN_MM,
    PAPERS,
    Card,
    arrange_cards,
    draw_page,
)

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
    for page in arrange_cards(PAPERS[paper], TAGS):
        picture = grey(draw_page(PAPERS[paper], page))
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
    (page,) = arrange_cards(PAPERS["a4"], [Card(0, 80.0, "robot a", "front", angle)])
    figure = draw_page(PAPERS["a4"], page)
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


@given(st.sampled_from(sorted(PAPERS)), st.lists(st.floats(10.0, 140.0), min_size=1, max_size=25))
def test_cards_are_on_the_paper_in_their_order_and_do_not_overlap(paper, sides):
    width, height = PAPERS[paper]
    cards = [Card(number, side, "x") for number, side in enumerate(sides)]
    pages = list(arrange_cards((width, height), cards))
    assert [card for page in pages for _, _, card in page] == cards
    for page in pages:
        boxes = []
        for x, y, card in page:
            whole = 1.25 * card.side_mm
            assert x >= MARGIN_MM and x + whole <= width - MARGIN_MM + 1e-9
            assert y + whole <= height - MARGIN_MM + 1e-9
            assert y - LABEL_HEIGHT_MM >= 2 * MARGIN_MM - 1e-9  # the ruler is below
            boxes.append((x, y - LABEL_HEIGHT_MM, x + whole, y + whole))
        for k, (left, low, right, top) in enumerate(boxes):
            for other_left, other_low, other_right, other_top in boxes[:k]:
                beside = left >= other_right - 1e-9 or right <= other_left + 1e-9
                assert beside or low >= other_top - 1e-9 or top <= other_low + 1e-9


def test_a_row_and_a_page_are_used_as_far_as_tags_fit():
    side = (PAPERS["a4"][0] - 2 * MARGIN_MM) / 3 / 1.25
    (page,) = arrange_cards(PAPERS["a4"], [Card(number, side - 1e-6, "x") for number in range(6)])
    assert len({x for x, _, _ in page}) == 3 and len({y for _, y, _ in page}) == 2
    tall = (PAPERS["a4"][1] - 3 * MARGIN_MM - LABEL_HEIGHT_MM) / 1.25
    wide = PAPERS["a4"][0] - 2 * MARGIN_MM
    assert len(list(arrange_cards((9999.0, PAPERS["a4"][1]), [Card(1, tall - 1e-6, "x")]))) == 1
    assert (
        len(list(arrange_cards((PAPERS["a4"][0], 9999.0), [Card(1, wide / 1.25 - 1e-6, "x")]))) == 1
    )
    for size, side in (
        ((9999.0, PAPERS["a4"][1]), tall),
        ((PAPERS["a4"][0], 9999.0), wide / 1.25),
    ):
        with pytest.raises(UsageError, match="tag 1"):
            list(arrange_cards(size, [Card(1, side + 1e-6, "x")]))


def test_the_ruler_is_100_mm_long():
    (page,) = arrange_cards(PAPERS["letter"], [Card(0, 50.0, "x")])
    axes = draw_page(PAPERS["letter"], page).axes[0]
    (line,) = [line for line in axes.lines if len(line.get_xdata()) == 2]
    assert np.ptp(line.get_xdata()) == pytest.approx(100.0) and np.ptp(line.get_ydata()) == 0
    assert min(line.get_xdata()) == min(line.get_ydata()) == MARGIN_MM
    assert axes.get_xlim() == (0.0, PAPERS["letter"][0])


def test_a_tag_that_no_page_holds_is_refused():
    with pytest.raises(UsageError, match="tag 3: the tag of 200 mm"):
        list(arrange_cards(PAPERS["a4"], [Card(3, 200.0, "x")]))


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
