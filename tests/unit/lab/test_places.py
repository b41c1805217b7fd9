"""Where robots must not drive."""

import math

import numpy as np

from tetractl.core.poses import Pose
from tetractl.core.setup import Bounds
from tetractl.core.shape import Shape
from tetractl.lab.guard_rules import GuardRules
from tetractl.lab.places import Keeps
from tetractl.spec.lab_section import LabLimits

DISC = Shape(np.array([[500.0, 500.0]]), 100.0)


RULES = GuardRules(
    names=("green",),
    speeds=(200.0,),
    turning=(math.pi,),
    arena=Bounds(0.0, 0.0, 1000.0, 1000.0),
    limits=LabLimits(reaction=0.5),
    obstacles=(DISC,),
)


def places(speed=0.0, turning=0.0):
    checked_places = Keeps(RULES)
    checked_places.sent(0, (speed,), (turning,))
    return checked_places


def test_a_robot_in_an_obstacle_is_found_there_whatever_it_is_commanded():
    checked_places = places()
    assert not checked_places.enters(0, Pose(395.0, 500.0, 0.0))
    assert checked_places.enters(0, Pose(401.0, 500.0, 0.0))


def test_a_robot_is_predicted_on_the_arc_that_it_is_commanded():
    """By 100 mm ahead in half a second, or round an eighth of a circle."""
    assert places(speed=200.0).enters(0, Pose(310.0, 500.0, 0.0))
    assert not places(speed=200.0).enters(0, Pose(290.0, 500.0, 0.0))
    assert not places(speed=200.0, turning=math.pi).enters(0, Pose(330.0, 500.0, 0.0))
    assert not places(speed=200.0).enters(0, Pose(310.0, 500.0, math.pi))


def test_a_robot_that_touches_an_obstacle_at_the_start_may_leave_but_not_go_deeper_again():
    checked_places = places(speed=200.0)
    assert not checked_places.enters(0, Pose(410.0, 500.0, 0.0))
    assert not checked_places.enters(0, Pose(405.0, 500.0, 0.0))
    assert checked_places.enters(0, Pose(408.0, 500.0, 0.0))
    checked_places.start()
    assert not checked_places.enters(0, Pose(408.0, 500.0, 0.0))
