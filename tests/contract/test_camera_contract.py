"""What every camera promises, whatever is behind it; see `tetractl.core.protocols.Camera`."""

import math

import pytest
from support.devices import CAMERAS

from tetractl.core.clock import SECOND


@pytest.fixture(params=CAMERAS)
def rig(request, tmp_path):
    with CAMERAS[request.param](tmp_path) as made:
        yield made


def frames(rig, count=10):
    """The next frames, at least so many."""
    found = []

    def enough():
        found.extend(rig.camera.frames())
        return len(found) >= count

    assert rig.wait(enough), "no frames come"
    return found


def test_a_frame_is_there_when_the_camera_is_entered(rig):
    assert rig.camera.newest is None
    with rig.camera as entered:
        assert entered is rig.camera
        assert len(rig.camera.newest.poses) == len(rig.setup.names)


def test_frames_come_once_each_in_order_with_their_times(rig):
    with rig.camera:
        rig.camera.frames()  # while it connects, a camera may not know its clock yet
        found = frames(rig, 30)
        numbers = [frame.number for frame in found]
        assert numbers == sorted(set(numbers))
        times = [frame.sampled_ns for frame in found]
        assert times == sorted(times)
        for frame in found:
            assert frame.sampled_ns <= frame.received_ns <= rig.clock.now()
            assert frame.fault == ""
            assert frame.strangers == ()
        assert rig.camera.newest.number >= numbers[-1]
        assert rig.camera.damaged == 0


def test_the_camera_wakes_whoever_waits_for_frames(rig):
    with rig.camera:
        frames(rig, 1)
        before = rig.woken()
        frames(rig, 5)
        assert rig.woken() >= before + 4


def test_poses_are_in_the_specs_coordinates_in_the_order_of_the_robots(rig):
    with rig.camera:
        newest = frames(rig)[-1]
        for pose, (x, y, heading) in zip(newest.poses, rig.poses(), strict=True):
            assert math.hypot(pose.x - x, pose.y - y) * rig.setup.metres < 0.005
            assert abs(math.remainder(pose.heading - heading, math.tau)) < 0.05


def test_height_and_tilt_of_a_robot_on_the_floor_are_those_of_its_body_or_not_told(rig):
    with rig.camera:
        for pose in frames(rig)[-1].poses:
            if pose.height is not None:
                assert abs(pose.height * rig.setup.metres - 0.06) < 0.05
            assert pose.tilt is None or 0.0 <= pose.tilt < 0.2


def test_a_robot_that_is_not_tracked_is_none_and_the_others_are_not(rig):
    with rig.camera:
        rig.hide(rig.setup.names[0])
        assert rig.wait(lambda: rig.camera.newest.poses[0] is None)
        assert all(pose is not None for pose in rig.camera.newest.poses[1:])


def test_a_healthy_camera_has_no_problems_however_often_it_is_asked(rig):
    with rig.camera:
        for _ in range(2):
            health = rig.camera.check()
            assert health.problems == ()
            assert all(isinstance(value, str) for value in health.facts.values())


def test_leaving_is_idempotent_and_ends_the_frames(rig):
    with rig.camera:
        frames(rig)
    rig.camera.__exit__(None, None, None)
    rig.camera.frames()
    rig.clock.sleep_until(rig.clock.now() + SECOND // 20)
    assert rig.camera.frames() == []


def test_leaving_needs_no_entering(rig):
    rig.camera.__exit__(None, None, None)
    rig.camera.__exit__(None, None, None)
