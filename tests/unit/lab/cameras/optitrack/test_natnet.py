"""Tests of versions, flags and poses of NatNet, at their limits."""

import cmath
import math

import pytest

from tetractl.lab.cameras.optitrack.natnet import (
    NORM_TOLERANCE,
    ModelDef,
    NatNetFrame,
    Placement,
    RigidBody,
    UpAxis,
    Version,
    planar_pose,
)


def body(position=(1.0, 2.0, 3.0), quaternion=(0.0, 0.0, 0.0, 1.0), valid=True):
    return RigidBody(1, position, quaternion, valid)


@pytest.mark.parametrize(
    ("text", "known"),
    [("2.5", False), ("2.6", True), ("2.10", True), ("4.3", True), ("4.4", False), ("5.0", False)],
)
def test_versions_are_known_from_the_oldest_to_the_newest(text, known):
    version = Version.parse(text)
    assert (version.known, str(version)) == (known, text)


def test_versions_are_ordered_by_their_numbers_not_as_text():
    assert Version.parse("2.9") < Version.parse("2.10") < Version.parse("3.0")


@pytest.mark.parametrize(
    ("params", "changed", "edits"),
    [(0, False, False), (1, False, False), (2, True, False), (4, False, True), (7, True, True)],
)
def test_a_frame_says_by_its_bits_whether_bodies_changed_and_whether_it_is_a_recording(
    params, changed, edits
):
    frame = NatNetFrame(1, (), params)
    assert (frame.models_changed, frame.is_edit_mode) == (changed, edits)


def test_a_model_maps_names_to_ids():
    assert ModelDef((("green", 11), ("blue", 12))).ids() == {"green": 11, "blue": 12}


@pytest.mark.parametrize("up", list(UpAxis))
@pytest.mark.parametrize("sign", [1, -1])
def test_a_quaternion_may_differ_from_norm_1_by_rounding_and_no_more(up, sign):
    for off, is_pose in [(0.99, True), (1.01, False)]:
        norm = 1 + sign * off * NORM_TOLERANCE
        assert (planar_pose(body(quaternion=(0, 0, 0, norm)), up) is not None) is is_pose


@pytest.mark.parametrize("up", list(UpAxis))
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", range(7))
def test_a_body_with_a_value_that_is_not_finite_has_no_pose(up, value, place):
    numbers = [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]
    numbers[place] = value
    assert planar_pose(body(tuple(numbers[:3]), tuple(numbers[3:])), up) is None


@pytest.mark.parametrize("up", list(UpAxis))
def test_a_body_that_is_not_tracked_has_no_pose(up):
    place = Placement(0, 0, 0, 1)
    assert planar_pose(body(valid=False), up) is None
    assert place.pose(body(valid=False), up) is None


@pytest.mark.parametrize("up", list(UpAxis))
def test_headings_are_within_half_a_turn_whatever_is_added(up):
    for k in range(-20, 21):
        pose = Placement(0, 0, 0.9 * k, 1).pose(body(), up, 0.7 * k)
        assert abs(pose.heading) <= math.pi
        assert math.remainder(pose.heading - 1.6 * k, math.tau) == pytest.approx(0, abs=1e-9)


def test_a_rotated_placement_turns_and_scales_and_then_moves():
    place = Placement(x=100.0, y=-50.0, rotation=math.pi / 2, scale=10.0)
    pose = place.pose(body(), UpAxis.Z)
    assert (pose.x, pose.y) == pytest.approx((100 - 20, -50 + 10))
    assert (pose.heading, pose.height, pose.tilt) == pytest.approx((math.pi / 2, 30.0, 0.0))


@pytest.mark.parametrize("rotation", [0.7, -2.0])
@pytest.mark.parametrize("up", list(UpAxis))
def test_any_rotation_of_a_placement_is_that_of_the_plane(rotation, up):
    place = Placement(x=100.0, y=-50.0, rotation=rotation, scale=25.0)
    planar = planar_pose(body((1.5, 2.5, -3.5)), up)
    pose = place.pose(body((1.5, 2.5, -3.5)), up)
    turned = cmath.rect(25.0, rotation) * complex(planar.x, planar.y) + complex(100, -50)
    assert complex(pose.x, pose.y) == pytest.approx(turned)
    assert pose.height == pytest.approx(25.0 * planar.height)
