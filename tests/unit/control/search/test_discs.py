"""Tests of robots' bodies as discs that touch obstacles and each other."""

from dataclasses import replace

import numpy as np
import pytest
from testkit import problems

from tetractl.control.search.discs import Discs
from tetractl.core.poses import Poses
from tetractl.core.setup import Bounds
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
    assert Discs(50, [BOX], None).collide(path) is enters


@pytest.mark.parametrize(
    ("gaps", "enters"),
    [((200, 110), False), ((200, 90), True), ((90, 95), False), ((90, 85), True)],
)
def test_a_body_enters_another_where_they_come_nearer_than_two_radii(gaps, enters):
    path = np.zeros((2, 2, 3))
    path[:, 1, 0] = gaps
    assert Discs(50, [], None).collide(path) is enters


def test_the_least_clearance_is_that_of_the_nearest_pair_of_anything():
    """From the box, 60 less the radius; of two robots, 90 less the separation."""
    discs = Discs(50, [BOX], None)
    y = np.full((2, 2), 1050.0)
    x = np.array([[940.0, 700.0], [500.0, 590.0]])
    assert discs.min_clearance(x, y, 100) == pytest.approx([10, -10])


def path_of(*places):
    """A path of robots, by x and y of each at each moment."""
    path = np.zeros((len(places), len(places[0]), 3))
    path[..., :2] = places
    return path


def test_a_body_that_passes_through_between_two_moments_enters():
    past = path_of([(900, 1050)], [(1200, 1050)])
    assert Discs(5, [BOX], None).collide(past)
    assert not Discs(5, [BOX], None).collide(past + np.array([0, 60, 0]))
    assert Discs(15, [BOX], None).collide(past + np.array([0, 60, 0]))


def test_a_body_that_begins_inside_may_only_come_out():
    """Also along another side than the nearest one at first, and with others clear."""
    discs = Discs(20, [BOX], Bounds(0, 0, 3000, 3000))
    out = path_of([(990, 1050), (500, 500)], [(960, 1050), (520, 500)], [(900, 1050), (540, 500)])
    assert not discs.collide(out)
    assert discs.collide(out[::-1].copy())
    second = out[:, ::-1].copy()
    assert not discs.collide(second)
    deeper = second.copy()
    deeper[2, 1, 0] = 1010
    assert discs.collide(deeper)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("place", "enters"), [(21, False), (19, True), (79, False), (81, True)])
def test_walls_are_as_far_as_the_radius(axis, place, enters):
    room = Bounds(0, 0, 100, 100)
    path = path_of([(50, 50)], [(50, 50)])
    path[1, 0, axis] = place
    assert Discs(20, [], room).collide(path) is enters
    assert Discs(20, [], None).collide(path) is False


def test_every_pair_of_bodies_is_compared_at_every_moment():
    still = np.array([(0, 0), (300, 0), (600, 0)], float)
    for i in range(3):
        for k in range(i):
            for moment in (1, 2):
                path = path_of(still, still, still)
                assert not Discs(50, [], None).collide(path)
                path[moment, i, :2] = still[k] + (0, 99)
                assert Discs(50, [], None).collide(path)
                path[moment, i, :2] = still[k] + (0, 100)
                assert not Discs(50, [], None).collide(path)


def test_held_directions_are_followed_for_the_whole_time():
    problem = problems.problem(problems.world(1, 1, 0, "exact"))
    poses = Poses(np.array([900.0]), np.array([1050.0]), np.zeros(1))
    problem = replace(problem, poses=poses, speed=np.array([100.0]))
    discs = Discs(20, [BOX], None)
    assert not discs.collide_if_held(problem, np.zeros(1), 0.79)
    assert discs.collide_if_held(problem, np.zeros(1), 0.81)
    assert not discs.collide_if_held(problem, np.full(1, np.nan), 5.0)
