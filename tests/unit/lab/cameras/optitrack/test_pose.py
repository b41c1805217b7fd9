import cmath
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.lab.cameras.optitrack.natnet import Placement, RigidBody, UpAxis, planar_pose

pytestmark = pytest.mark.slow

angles = st.floats(-math.pi, math.pi)


def body(position=(1.0, 2.0, 3.0), quaternion=(0.0, 0.0, 0.0, 1.0), valid=True):
    return RigidBody(1, position, quaternion, valid)


def turned_about(axis, angle):
    """Return the quaternion of a turn about x, y or z (0, 1, 2)."""
    values = [0.0, 0.0, 0.0, math.cos(angle / 2)]
    values[axis] = math.sin(angle / 2)
    return tuple(values)


def product(p, q):
    (a, b, c, d) = p
    (e, f, g, h) = q
    return (
        d * e + a * h + b * g - c * f,
        d * f - a * g + b * h + c * e,
        d * g + a * f - b * e + c * h,
        d * h - a * e - b * f - c * g,
    )


def same_angle(a, b):
    return abs(math.remainder(a - b, math.tau)) < 1e-9


@given(heading=angles, tilt=st.floats(0.0, math.pi), about=st.sampled_from([0, 1]))
def test_tilt_is_the_angle_of_the_bodys_own_vertical_axis(heading, tilt, about):
    z_up = product(turned_about(2, heading), turned_about(about, tilt))
    y_up = product(turned_about(1, heading), turned_about(2 * about, tilt))
    seen_z = planar_pose(body(quaternion=z_up), UpAxis.Z)
    seen_y = planar_pose(body(quaternion=y_up), UpAxis.Y)
    assert seen_z.tilt == pytest.approx(tilt, abs=1e-6)
    assert seen_y.tilt == pytest.approx(tilt, abs=1e-6)
    assert (seen_z.height, seen_y.height) == (3.0, 2.0)


@given(heading=angles, tilt=st.floats(-1.0, 1.0), offset=angles)
def test_heading_is_where_the_bodys_x_axis_points_also_when_tilted(heading, tilt, offset):
    turned_z_up = product(turned_about(2, heading), turned_about(1, tilt))
    turned_y_up = product(turned_about(1, heading), turned_about(2, tilt))
    z_up = planar_pose(body(quaternion=turned_z_up), UpAxis.Z, offset)
    y_up = planar_pose(body(quaternion=turned_y_up), UpAxis.Y, offset)
    assert (z_up.x, z_up.y) == (1.0, 2.0)
    assert (y_up.x, y_up.y) == (1.0, -3.0)
    assert same_angle(z_up.heading, heading + offset)
    assert same_angle(y_up.heading, heading + offset)
    assert abs(y_up.heading) <= math.pi


@pytest.mark.parametrize(
    "untracked",
    [
        body(valid=False),
        body(position=(math.nan, 0.0, 0.0)),
        body(position=(0.0, math.inf, 0.0)),
        body(quaternion=(0.0, 0.0, 0.0, math.nan)),
        body(quaternion=(0.0, 0.0, 0.0, math.inf)),
        body(quaternion=(0.0, 0.0, 0.0, 0.0)),
        body(quaternion=(0.0, 0.0, 0.0, 1.01)),
    ],
)
def test_what_cannot_be_trusted_is_not_tracked(untracked):
    assert planar_pose(untracked, UpAxis.Z) is None
    assert planar_pose(untracked, UpAxis.Y) is None


@given(
    x=st.floats(-5, 5),
    y=st.floats(-5, 5),
    heading=angles,
    rotation=angles,
    scale=st.sampled_from([1.0, 1000.0]),
)
def test_a_placement_turns_scales_and_shifts_a_pose(x, y, heading, rotation, scale):
    placement = Placement(x=70.0, y=-30.0, rotation=rotation, scale=scale)
    seen = body((x, y, 0.25), turned_about(2, heading))
    pose = placement.pose(seen, UpAxis.Z, heading_offset=0.1)
    placed = complex(70.0, -30.0) + scale * complex(x, y) * cmath.exp(1j * rotation)
    assert complex(pose.x, pose.y) == pytest.approx(placed)
    assert same_angle(pose.heading, heading + 0.1 + rotation)
    assert abs(pose.heading) <= math.pi
    assert pose.height == pytest.approx(0.25 * scale)
    assert pose.tilt == pytest.approx(0.0, abs=1e-6)


def test_a_body_that_is_not_tracked_has_no_place():
    placement = Placement(0.0, 0.0, 0.0, 1000.0)
    assert placement.pose(body(valid=False), UpAxis.Z) is None
