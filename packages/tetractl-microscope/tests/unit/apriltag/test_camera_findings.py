"""Tests of what the AprilTag camera finds wrong with tags, floor and lens, without any image."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from testkit.microscope.tag_scene import FLOOR, MM, NAMES, ROBOTS, section
from tetractl_microscope.apriltag import camera as tag_camera
from tetractl_microscope.apriltag.camera import AprilTagCamera, Seen, Tracker, _is_unexplained
from tetractl_microscope.apriltag.detect import Sighting
from tetractl_microscope.apriltag.floor import CORNER_PX

from tetractl.core.clock import VirtualClock

ALL = tuple(sorted([*(tag.tag for tag in FLOOR), *(robot.tag for robot in ROBOTS)]))
GOOD = SimpleNamespace(
    error_max_mm=0.8, lens_error_mm=0.5, camera_height_mm=2000.0, error_mm=0.424, focal_px=1203.7
)


def plane(**changes):
    return SimpleNamespace(**{**vars(GOOD), **changes})


def seen(tags=ALL, sizes=(1.0, 1.0, 1.0), blur=0.2, side_px=40.0):
    return SimpleNamespace(result=Seen((None,) * 3, (), tags, sizes, blur, side_px))


def health(searches, at=GOOD, misfit=None, **changes):
    made = AprilTagCamera(
        section(**changes), SimpleNamespace(names=NAMES, metres=MM), VirtualClock()
    )
    made._tracker.floor.plane = at
    made._tracker.floor.misfit = misfit
    return made._health(searches)


def without(*numbers):
    return tuple(tag for tag in ALL if tag not in numbers)


def test_a_good_camera_has_facts_and_nothing_to_say():
    found = health([seen(), seen(side_px=38.4)])
    assert found.problems == found.warnings == ()
    assert found.facts == {
        "latency": "0.05 s, as the spec says",
        "floor_error": "0.42 mm",
        "focal_length": "1204 px, estimated",
        "smallest_tag": "38 px",
    }


def test_the_focal_length_of_the_spec_is_named_as_such():
    found = health([seen()], lens={"focal_px": 1200.0})
    assert found.facts["focal_length"].endswith("px, the spec's")


def test_without_tags_and_calibration_there_are_fewer_facts():
    nothing = [seen((), (None,) * 3, None, None)] * 3
    found = health(nothing, at=None)
    assert list(found.facts) == ["latency"]
    assert found.warnings == ()
    assert len(found.problems) == 4
    assert (
        found.problems[0]
        == "floor tags 100, 101, 102, 103 are not seen by the camera; tags seen: none"
    )


@pytest.mark.parametrize(("shown", "of", "is_missing"), [(2, 4, False), (1, 4, True), (2, 5, True)])
@pytest.mark.parametrize("tag", [101, 7])
def test_a_tag_is_missing_if_fewer_than_half_of_the_images_show_it(shown, of, is_missing, tag):
    searches = [seen()] * shown + [seen(without(tag))] * (of - shown)
    problems = health(searches).problems
    assert len(problems) == is_missing
    named = "floor tag 101 is not seen" if tag == 101 else "blue: the camera does not see tag 7"
    assert all(line.startswith(named) for line in problems)
    assert all(str(tag) not in line.split("tags seen:")[1] for line in problems)


@pytest.mark.parametrize(
    ("tag", "says"),
    [
        (102, "floor tag 102 is seen twice"),
        (0, "green: the camera sees tag 0 twice"),
    ],
)
def test_a_tag_that_one_image_shows_twice_is_a_problem(tag, says):
    searches = [seen(), seen(tuple(sorted([*ALL, tag]))), seen()]
    (problem,) = health(searches).problems
    assert problem.startswith(says)


def test_a_tag_that_is_not_in_the_spec_may_be_seen_twice():
    assert health([seen((*ALL, 300, 300))]).problems == ()


@pytest.mark.parametrize(
    ("error_max_mm", "problems", "warnings"),
    [(2.9, 0, 0), (3.0, 0, 0), (3.1, 0, 1), (10.0, 0, 1), (10.1, 1, 0), (math.nan, 1, 0)],
)
def test_misplaced_floor_tags_are_a_warning_and_then_a_problem(error_max_mm, problems, warnings):
    found = health([seen()], plane(error_max_mm=error_max_mm))
    assert (len(found.problems), len(found.warnings)) == (problems, warnings)
    for line in (*found.problems, *found.warnings):
        assert line.startswith(f"the floor tags are up to {error_max_mm:.1f} mm away")


@pytest.mark.parametrize(
    ("lens_error_mm", "problems", "warnings"),
    [(3.0, 0, 0), (3.1, 0, 1), (10.0, 0, 1), (10.1, 1, 0)],
)
def test_a_lens_that_the_floor_leaves_open_is_a_warning_and_then_a_problem(
    lens_error_mm, problems, warnings
):
    found = health([seen()], plane(lens_error_mm=lens_error_mm))
    assert (len(found.problems), len(found.warnings)) == (problems, warnings)
    for line in (*found.problems, *found.warnings):
        assert f"located {lens_error_mm:.0f} mm off" in line
    given = health([seen()], plane(lens_error_mm=lens_error_mm), lens={"focal_px": 1200.0})
    assert given.problems == given.warnings == ()


def test_a_calibration_that_does_not_fit_is_explained_too():
    found = health([seen()], at=None, misfit=plane(error_max_mm=40.0))
    assert found.problems[0].startswith("the floor tags are up to 40.0 mm away")
    assert found.facts["floor_error"] == "0.42 mm"


@pytest.mark.parametrize(
    ("ratio", "refused", "says"),
    [
        (1.0, False, ""),
        (1.005, False, ""),
        (0.98, False, "2.0 % smaller"),
        (1.05, False, "5.0 % larger"),
        (1.19, False, "19.0 % larger"),
        (0.79, True, "21.0 % smaller"),
        (1.21, True, "21.0 % larger"),
    ],
)
def test_a_tag_of_another_size_is_a_warning_and_from_a_fifth_on_a_problem(ratio, refused, says):
    found = health([seen(sizes=(1.0, ratio, 1.0))])
    lines = found.problems if refused else found.warnings
    assert len(found.problems) + len(found.warnings) == len(lines) == bool(says)
    assert all(line.startswith(f"blue: the tag looks {says} than the spec says") for line in lines)


def test_the_size_is_the_median_of_the_images_that_show_the_tag():
    sizes = [(1.0, None, 1.0), (1.0, 1.0, 1.0), (1.0, 1.5, 1.0), (1.0, 1.0, 1.0)]
    found = health([seen(sizes=size) for size in sizes])
    assert found.problems == found.warnings == ()


def test_a_small_or_distant_tag_may_look_larger_by_noise():
    usual = _is_unexplained(1.02, 40.0, 80.0, 2000.0)
    assert usual
    assert not _is_unexplained(1.02, 8.0, 80.0, 2000.0)  # few pixels
    assert not _is_unexplained(1.02, 40.0, 25.0, 2000.0)  # a ruler is no better than half a mm
    assert not _is_unexplained(1.02, 40.0, 80.0, 400.0)  # its height is known to 5 mm


@pytest.mark.parametrize("sign", [1, -1])
def test_the_limit_is_the_sum_of_noise_ruler_and_height(sign):
    limit = 3 * CORNER_PX / math.sqrt(2) / 30.0 + 0.5 / 60.0 + 5.0 / 1500.0
    assert _is_unexplained(1 + sign * 1.01 * limit, 30.0, 60.0, 1500.0)
    assert not _is_unexplained(1 + sign * 0.99 * limit, 30.0, 60.0, 1500.0)


def test_the_height_of_a_robot_s_tag_makes_it_nearer_to_the_camera():
    """A tag that is 150 mm below the camera may be 5 mm too high."""
    sizes = (1.04, 1.0, 1.0)
    near = health([seen(sizes=sizes)], plane(camera_height_mm=ROBOTS[0].height_mm + 150.0))
    far = health([seen(sizes=sizes)], plane(camera_height_mm=ROBOTS[0].height_mm + 300.0))
    assert near.warnings == () and len(far.warnings) == 1


@pytest.mark.parametrize(("blurs", "warns"), [((0.35, 0.5, 0.2), 0), ((0.37, 0.5, 0.2), 1)])
def test_blurred_tags_are_a_warning_with_the_smallest(blurs, warns):
    searches = [
        seen(blur=blur, side_px=side) for blur, side in zip(blurs, (30, 12, 20), strict=True)
    ]
    found = health(searches)
    assert len(found.warnings) == warns
    assert all("the smallest is 12 px wide" in line for line in found.warnings)


# ---- the tracker, with tags that are not searched in an image ----


class Above:
    """A camera that looks straight down, 1 px for each mm of the floor, from 2 m above."""

    camera_height_mm = 2000.0

    def __init__(self, stance=(0.09, 0.02)):
        self.now = stance

    def locate(self, pixels, height=0.0):
        return np.asarray(pixels) * (1e-3, -1e-3) * (2.0 - height) / 2.0

    def height_and_tilt(self, corners, side):
        return self.now


def square(x, y, side, heading=0.0):
    """Corners [px] of a tag on the floor at x, y [mm]."""
    flat = side / 2 * np.array([-1 + 1j, 1 + 1j, 1 - 1j, -1 - 1j]) * np.exp(1j * heading)
    return np.column_stack([x + flat.real, -(y + flat.imag)])


def tracker_of(*sightings, above=None):
    tracker = Tracker(section(), NAMES, MM)
    tracker.floor = SimpleNamespace(plane=above or Above(), update=lambda corners, size: None)
    tracker._detector = SimpleNamespace(find=lambda picture: list(sightings))
    return tracker


PICTURE = np.zeros((480, 640), np.uint8)


def raised(side_mm, height_mm):
    """The side of a tag [px], seen from 2 m above."""
    return side_mm * 2000.0 / (2000.0 - height_mm)


def test_a_robot_is_where_its_tag_is_at_the_height_of_the_tag():
    side = raised(80, 90)
    looked = tracker_of(Sighting(0, square(500, 300, side, 0.7), 2.0)).track_image(PICTURE)
    pose, *others = looked.poses
    assert others == [None, None]
    scale = (2000 - 90) / 2000
    assert (pose.x, pose.y) == pytest.approx((500 * scale, 300 * scale))
    assert pose.heading == pytest.approx(0.7)
    assert looked.sizes == (pytest.approx(1.0), None, None)
    assert pose.height == pytest.approx(90.0) and pose.tilt == 0.02
    assert looked.side_px == pytest.approx(side) and looked.blur == pytest.approx(16 / side)
    assert looked.tags == (0,) and looked.unknown_objects == ()


def test_a_heading_offset_is_added():
    looked = tracker_of(Sighting(7, square(500, 300, raised(80, 90), 0.2), 1.0)).track_image(
        PICTURE
    )
    assert looked.poses[1].heading == pytest.approx(0.7)


@pytest.mark.parametrize(
    ("ratio", "tracked"), [(0.81, True), (1.19, True), (0.79, False), (1.21, False)]
)
def test_a_tag_of_another_size_is_another_tag(ratio, tracked):
    side = ratio * raised(80, 90)
    looked = tracker_of(Sighting(0, square(500, 300, side), 1.0)).track_image(PICTURE)
    assert (looked.poses[0] is not None) is tracked
    assert looked.sizes[0] == pytest.approx(ratio)


@pytest.mark.parametrize(("side_px", "shows_height"), [(25.1, True), (24.9, False)])
def test_only_a_tag_of_25_pixels_shows_its_height(side_px, shows_height, monkeypatch):
    monkeypatch.setattr(tag_camera, "SIZE_DEVIATION_MAX", math.inf)
    looked = tracker_of(Sighting(0, square(500, 300, side_px), 1.0)).track_image(PICTURE)
    assert (looked.poses[0].height is not None) is shows_height
    assert looked.poses[0].tilt == 0.02


def test_a_tag_whose_stance_fits_no_pose_has_a_place_all_the_same():
    flat = Above(stance=None)
    looked = tracker_of(Sighting(0, square(500, 300, raised(80, 90)), 1.0), above=flat).track_image(
        PICTURE
    )
    assert looked.poses[0] is not None and looked.poses[0].height is None


def test_tags_that_are_not_in_the_spec_are_objects_on_the_floor():
    sightings = [
        Sighting(333, square(700, 800, 50, 1.0), 9.0),
        Sighting(100, square(400, 250, 120), 2.0),
        Sighting(0, square(500, 300, raised(80, 90)), 1.0),
    ]
    looked = tracker_of(*sightings).track_image(PICTURE)
    (unknown,) = looked.unknown_objects
    assert (unknown.x, unknown.y, unknown.heading) == pytest.approx((700, 800, 1.0))
    assert looked.tags == (0, 100, 333)
    assert looked.side_px == pytest.approx(raised(80, 90))  # not that of the unknown tag
    assert looked.blur == pytest.approx(8 * 2.0 / 120)


def test_a_robot_whose_tag_is_seen_twice_is_not_tracked():
    twice = [Sighting(0, square(x, 300, raised(80, 90)), 1.0) for x in (500, 900)]
    looked = tracker_of(*twice).track_image(PICTURE)
    assert looked.poses == (None, None, None) and looked.sizes == (None, None, None)
    assert looked.tags == (0, 0)


def test_an_image_without_tags_has_no_blur_and_no_size():
    looked = tracker_of().track_image(PICTURE)
    assert looked.blur is looked.side_px is None
    assert looked.tags == looked.unknown_objects == ()
