"""`tetractl lab markers`: tags are read from the pages again, at their size and place."""

import re

import numpy as np
import pytest
from support.cli import tetractl
from tetractl_microscope.apriltag.detect import Detector
from tetractl_microscope.markers import INCH_MM, PAPERS, arranged, drawn

from tetractl.core.errors import UsageError

pytestmark = pytest.mark.slow
TAGS = [(0, 70.0, "a"), (1, 70.0, "b"), (100, 150.0, "c"), (586, 40.0, "d"), (2, 30.0, "e")]
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
            x, y, _, side, _ = next(tag for tag in page if tag[2] == sighting.tag)
            top_left = x + side / 8, PAPERS[paper][1] - (y + side * 9 / 8)
            assert mm[0] == pytest.approx(top_left, abs=0.15)
            assert mm[2] == pytest.approx(np.add(top_left, side), abs=0.15)
    assert sightings.keys() == {tag for tag, *_ in TAGS}


def test_a_tag_that_no_page_holds_is_refused():
    with pytest.raises(UsageError, match="tag 3: 200 mm"):
        list(arranged(PAPERS["a4"], [(3, 200.0, "x")]))


@pytest.mark.long
def test_a_new_spec_with_tags_is_printed_on_true_pages(tmp_path):
    tetractl(tmp_path, "init", "shelf", "--lab", "--camera", "apriltag", "--robots", "twist").ok()
    done = tetractl(tmp_path, "lab", "markers", "shelf.yaml", "-o", "tags.pdf").ok()
    assert done.stderr == "print it without scaling: 7 tags on 5 pages of a4 paper\n"
    pages = re.findall(
        rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", (tmp_path / "tags.pdf").read_bytes()
    )
    assert len(pages) == 5
    size = [float(points) / 72 * INCH_MM for points in pages[0]]
    assert size == pytest.approx(PAPERS["a4"], abs=0.01)
    for words, why in (
        (["shelf.yaml", "--paper", "a5"], "--paper a5: must be a4, a3, letter"),
        (["shelf.yaml", "-o", "no/tags.pdf"], "there is no folder no"),
    ):
        wrong = tetractl(tmp_path, "lab", "markers", *words)
        assert (wrong.returncode, why in wrong.stderr) == (2, True)


def test_a_camera_without_tags_is_one_line(tmp_path):
    tetractl(tmp_path, "init", "first", "--lab").ok()
    done = tetractl(tmp_path, "lab", "markers", "first.yaml")
    assert done.returncode == 2
    assert done.stderr.startswith(
        "error: first.yaml: lab.camera is of type optitrack, which has no"
    )
