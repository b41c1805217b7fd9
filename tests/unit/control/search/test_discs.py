"""Tests of robots' bodies as discs that touch obstacles and each other."""

import numpy as np
import pytest

from tetractl.control.search.discs import Discs
from tetractl.model.shapes import Rectangle

BOX = Rectangle(type="rectangle", left=1000, bottom=1000, width=100, height=100).shape()


@pytest.mark.parametrize(
    ("x0", "x1", "enters"),
    [(940, 949, False), (940, 951, True), (960, 961, True), (960, 959, False)],
)
def test_a_body_enters_where_it_touches_or_goes_deeper(x0, x1, enters):
    path = np.zeros((4, 1, 3))
    path[:, 0, 0] = np.linspace(x0, x1, 4)
    path[:, 0, 1] = 1050.0
    assert Discs(50, [BOX], None).enters(path) is enters


@pytest.mark.parametrize(
    ("gaps", "enters"),
    [((200, 110), False), ((200, 90), True), ((90, 95), False), ((90, 85), True)],
)
def test_a_body_enters_another_where_they_come_nearer_than_two_radii(gaps, enters):
    path = np.zeros((2, 2, 3))
    path[:, 1, 0] = gaps
    assert Discs(50, [], None).enters(path) is enters


def test_the_least_clearance_is_that_of_the_nearest_pair_of_anything():
    """From the box, 60 less the radius; of two robots, 90 less the separation."""
    discs = Discs(50, [BOX], None)
    y = np.full((2, 2), 1050.0)
    x = np.array([[940.0, 700.0], [500.0, 590.0]])
    assert discs.least_clearance(x, y, 100) == pytest.approx([10, -10])
