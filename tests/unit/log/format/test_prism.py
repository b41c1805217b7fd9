"""Tests of the solid bodies that viewers draw from the outline of a shape."""

import numpy as np
from hypothesis import given
from testkit.shapes import SHAPES

from tetractl.log.format.scene import prism, triangulate


def doubled_area_within(outline):
    """Twice the area of a polygon whose corners go counterclockwise, by the shoelace formula."""
    x, y = outline.T
    return np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)


def doubled_areas(a, b, c):
    """Twice the area of each triangle, negative if its corners go clockwise."""
    return (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])


@given(SHAPES)
def test_the_triangles_cover_the_outline_and_no_more(section):
    outline = section.shape().outline()
    triangles = triangulate(outline)
    assert triangles.shape == (len(outline) - 2, 3)
    areas = doubled_areas(*(outline[triangles[:, i]] for i in range(3)))
    assert np.all(areas >= -1e-9)
    assert np.isclose(areas.sum(), doubled_area_within(outline), rtol=1e-9)


@given(SHAPES)
def test_walls_stand_on_the_outline_and_face_outwards(section):
    outline = section.shape().outline()
    corners, triangles = prism(outline, 3.0)
    assert corners[:, 2].tolist() == [0.0] * len(outline) + [3.0] * len(outline)
    assert np.array_equal(corners[: len(outline), :2], outline)
    a, b, c = (corners[triangles[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    volume = np.einsum("ij,ij->i", a, normals).sum() / 6  # of a closed surface but for its floor
    area = doubled_area_within(outline) / 2
    assert np.isclose(volume, 3.0 * area, rtol=1e-9)
    top = normals[2 * len(outline) :]
    assert np.all(top[:, 2] >= -1e-9)
