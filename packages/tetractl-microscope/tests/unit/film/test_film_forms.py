"""Films whose writers use another form of their format: each gives the same pictures."""

import numpy as np
import pytest
import support.needs_opencv  # noqa: F401
import tifffile
from tetractl_microscope.film.pictures import open_film

from tetractl.core.errors import UsageError

pytestmark = pytest.mark.slow

PICTURES = np.random.default_rng(1).integers(0, 255, (6, 48, 64)).astype(np.uint8)


def thumbnail_first(path):
    with tifffile.TiffWriter(path) as file:
        for picture in (PICTURES[0, ::4, ::4], *PICTURES):
            file.write(picture, photometric="minisblack", metadata=None)


def two_positions(path):
    with tifffile.TiffWriter(path, ome=True) as file:
        for pictures in (PICTURES, PICTURES // 2):
            file.write(pictures, photometric="minisblack", metadata={"axes": "TYX"})


def palette(path):
    colors = np.array([[257 * k, 257 * min(2 * k, 255), 0] for k in range(256)], np.uint16).T
    tifffile.imwrite(path, PICTURES, photometric="palette", colormap=colors)


@pytest.mark.parametrize(
    ("name", "write", "remarks"),
    [
        ("thumbnail.tif", thumbnail_first, ["the longest of its 2 series of pictures is read"]),
        ("two.ome.tif", two_positions, ["the longest of its 2 series of pictures is read"]),
        ("palette.tif", palette, []),
    ],
)
def test_the_pictures_are_those_that_were_taken(name, write, remarks, tmp_path):
    """Regression: a film after its thumbnail was "one picture, and no film"; positions were left
    out unsaid."""
    write(tmp_path / name)
    opened = open_film(tmp_path / name, 30.0)
    assert np.array_equal([picture for _, picture in opened], PICTURES)
    assert opened.remarks == remarks


@pytest.mark.long
def test_a_tiff_file_that_is_cut_short_is_said_to_be(tmp_path):
    """Regression: "is one picture, and no film"; "attempt to get argmax of an empty sequence"."""
    tifffile.imwrite(tmp_path / "whole.tif", PICTURES, imagej=True)
    data = (tmp_path / "whole.tif").read_bytes()
    (tmp_path / "cut.tif").write_bytes(data[: len(data) * 3 // 4])
    with pytest.raises(UsageError, match=f"states {len(PICTURES)} pictures, and has 1"):
        open_film(tmp_path / "cut.tif", 30.0)
    (tmp_path / "empty.tif").write_bytes(b"II*\0" + bytes(100))
    with pytest.raises(UsageError, match="is a TIFF file without pictures"):
        open_film(tmp_path / "empty.tif", 30.0)
