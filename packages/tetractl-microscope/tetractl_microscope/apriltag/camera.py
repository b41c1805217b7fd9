"""The `apriltag` camera: it tracks robots by their tags, and checks tags, floor and lens."""

import math
import statistics
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tetractl.core.clock import Clock
from tetractl.core.poses import Floats, GreyImage, Pose
from tetractl.core.protocols import Health
from tetractl.core.setup import Setup
from tetractl.spec.lab_section import entry
from tetractl_microscope.apriltag.detect import Detector, Sighting
from tetractl_microscope.apriltag.floor import (
    CORNER_PX,
    MILLIMETRE_M,
    MISFIT_MM,
    SQUARE,
    Floor,
    Plane,
)
from tetractl_microscope.apriltag.section import AprilTagSection, RobotTag
from tetractl_microscope.pictures.picture_camera import OpenMemorySource, PictureCamera
from tetractl_microscope.pictures.searches import PictureSearch, drop_none

SIZE_DEVIATION_MAX = 0.2
"""Maximum relative deviation of a tag's size from the spec.

Beyond this value, it is another tag, or a tag at another height.
"""
HEIGHT_SIDE_MIN_PX = 25.0
"""Minimum side of a tag for measuring its height [px].

At 25 px, measured heights differ by up to 16 mm from place to place, at 23 px by 42 mm, and at 15
px by 59 mm.
"""
_SQUARE_COMPLEX = SQUARE[:, 0] + 1j * SQUARE[:, 1]


@dataclass(frozen=True, slots=True)
class Seen:
    """The tags that were found in one image. Poses are in the spec's length unit.

    Attributes:
        poses: Pose of each robot. None if it is untracked.
        unknown_objects: Poses of tags that are not in the spec, computed as if they were on the
            floor.
        tags: The numbers of all tags, repeated if a tag is seen several times.
        sizes: For each robot, the measured side of its tag relative to `size_mm`. None if not seen.
        blur: Maximum blur of an edge of the robots' and floor tags [modules: eighths of a tag's
            side]. None if no such tag is seen.
        side_px: Minimum side of these tags [px]. None if no such tag is seen.
    """

    poses: tuple[Pose | None, ...]
    unknown_objects: tuple[Pose, ...]
    tags: tuple[int, ...]
    sizes: tuple[float | None, ...]
    blur: float | None
    side_px: float | None


class Tracker:
    """Finds the tags of robots and floor in images, and computes the robots' poses.

    Args:
        section: The fields of the camera in the spec.
        names: Names of the robots.
        metres: The spec's length unit [m].
    """

    def __init__(self, section: AprilTagSection, names: Sequence[str], metres: float) -> None:
        self.robots = [entry(section.robots, name) for name in names]
        self._floor_tags = {tag.tag for tag in section.floor}
        self._listed_tags = self._floor_tags | {robot.tag for robot in self.robots}
        self._metres = metres
        self._detector = Detector()
        highest = max(robot.height_mm for robot in self.robots)
        self.floor = Floor(section.floor, metres, section.lens, highest)

    def track_image(self, picture: GreyImage) -> Seen:
        """Find the tags in a grey image (height, width), and compute the poses of the robots.

        If a number is seen on two tags, both are ignored: the robot with this tag is untracked, or
        the floor tag is not used.
        """
        sightings = self._detector.find(picture)
        counts = Counter(sighting.tag for sighting in sightings)
        unique_sightings = {
            sighting.tag: sighting for sighting in sightings if counts[sighting.tag] == 1
        }
        corners = {
            number: unique_sightings[number].corners
            for number in unique_sightings
            if number in self._floor_tags
        }
        self.floor.update(corners, (picture.shape[1], picture.shape[0]))
        measured = [
            self._locate_robot(robot, unique_sightings.get(robot.tag)) for robot in self.robots
        ]
        listed_sightings = [sighting for sighting in sightings if sighting.tag in self._listed_tags]
        return Seen(
            tuple(pose for pose, _ in measured),
            self._unknown_tags(sightings),
            tuple(sorted(sighting.tag for sighting in sightings)),
            tuple(size for _, size in measured),
            max(
                (8 * sighting.blur_px / sighting.side_px for sighting in listed_sightings),
                default=None,
            ),
            min((sighting.side_px for sighting in listed_sightings), default=None),
        )

    def _locate_robot(
        self, robot: RobotTag, sighting: Sighting | None
    ) -> tuple[Pose | None, float | None]:
        """Compute a robot's pose, and the measured side of its tag relative to `size_mm`.

        The pose is None if the tag is not seen or has the wrong size. The size is None if the tag
        is not seen.
        """
        plane = self.floor.plane
        if sighting is None or plane is None:
            return None, None
        corners = plane.locate(sighting.corners, robot.height_mm * MILLIMETRE_M)
        pose, side_m = self._fit_pose(corners, robot.heading_offset)
        relative_size = side_m / (robot.size_mm * MILLIMETRE_M)
        if abs(relative_size - 1) >= SIZE_DEVIATION_MAX:
            return None, relative_size
        stance = plane.height_and_tilt(sighting.corners, robot.size_mm * MILLIMETRE_M)
        if stance is not None:
            height, tilt = stance
            measures_height = sighting.side_px >= HEIGHT_SIDE_MIN_PX
            height = height / self._metres if measures_height else None
            pose = replace(pose, height=height, tilt=tilt)
        return pose, relative_size

    def _unknown_tags(self, sightings: Sequence[Sighting]) -> tuple[Pose, ...]:
        """Compute the poses of tags that are not in the spec, as if they were on the floor.

        The result is empty until the floor is known.
        """
        plane = self.floor.plane
        if plane is None:
            return ()
        unknown = (sighting for sighting in sightings if sighting.tag not in self._listed_tags)
        return tuple(self._fit_pose(plane.locate(sighting.corners), 0.0)[0] for sighting in unknown)

    def _fit_pose(self, corners: Floats, heading_offset: float) -> tuple[Pose, float]:
        """Fit a square to four corners, shape (4, 2) [m], and turn its heading by an offset [rad].

        Returns:
            Its pose in the spec's length unit, and the length of its side [m].
        """
        x, y = corners.mean(axis=0) / self._metres
        scale_and_turn = (
            np.vdot(_SQUARE_COMPLEX, corners[:, 0] + 1j * corners[:, 1])
            / np.vdot(_SQUARE_COMPLEX, _SQUARE_COMPLEX).real
        )
        heading = math.atan2(scale_and_turn.imag, scale_and_turn.real) + heading_offset
        pose = Pose(float(x), float(y), heading)
        return pose, float(abs(scale_and_turn))


BLUR_MAX = 0.36  # maximum blur [modules] at which all tags can be read
SIZE_SDS = 3.0  # maximum deviation of a size that noise explains [standard deviations]
SIZE_SD_MM = 0.5  # error of the side of a tag that is measured with a ruler
HEIGHT_SD_MM = 5.0  # error of the height of a robot's tag in the spec
# Maximum position error of a floor tag, or of a robot because of an uncertain lens, without a
# warning.
POSITION_ERROR_MAX_MM = 3.0


Finding = tuple[bool, str]
"""A finding of a check: whether it is a problem (True) or a warning (False), and its text."""


def _check_tags(
    section: AprilTagSection, tracker: Tracker, searches: Sequence[PictureSearch[Seen]]
) -> Iterator[Finding]:
    """Yield a finding for each problem or warning about the tags in the newest images.

    A finding is a pair: whether it is a problem, and its text. At least one image is needed,
    and a tag that fewer than half of the images show counts as not seen.
    """
    counts = Counter(tag for search in searches for tag in set(search.result.tags))
    # a tag seen in fewer than half of the pictures counts as not seen
    shown_tags = sorted(tag for tag, n in counts.items() if n >= 0.5 * len(searches))
    repeated_tags = {
        tag for search in searches for tag, n in Counter(search.result.tags).items() if n > 1
    }
    seen_tags_text = f"; tags seen: {_join_numbers(shown_tags)}"
    floor = [tag.tag for tag in section.floor]
    missing = [tag for tag in floor if tag not in shown_tags]
    if missing:
        yield True, f"floor {_describe_tags(missing)} not seen by the camera{seen_tags_text}"
    repeated_floor = [tag for tag in floor if tag in repeated_tags]
    if repeated_floor:
        yield (
            True,
            f"floor {_describe_tags(repeated_floor)} seen twice, but each tag number may be used "
            "only once",
        )
    plane = tracker.floor.plane or tracker.floor.misfit
    if plane is not None:
        yield from _check_calibration(section, plane)
    camera_height_mm = plane.camera_height_mm if plane is not None else math.inf
    sides_px = drop_none(search.result.side_px for search in searches)
    for i, robot in enumerate(tracker.robots):
        sizes = drop_none(search.result.sizes[i] for search in searches)
        if robot.tag in repeated_tags:
            yield (
                True,
                (
                    f"{robot.name}: the camera sees tag {robot.tag} twice, so the robot is "
                    "not tracked"
                ),
            )
        elif robot.tag not in shown_tags:
            yield True, f"{robot.name}: the camera does not see tag {robot.tag}{seen_tags_text}"
        elif sizes:
            ratio = statistics.median(sizes)
            if _is_unexplained(
                ratio, min(sides_px), robot.size_mm, camera_height_mm - robot.height_mm
            ):
                size_text = f"{abs(100 * (ratio - 1)):.1f} % {'larger' if ratio > 1 else 'smaller'}"
                yield (
                    abs(ratio - 1) >= SIZE_DEVIATION_MAX,
                    f"{robot.name}: the tag looks {size_text} than the spec says: check size_mm "
                    "and height_mm, and that all tags were printed at 100 %",
                )


def _check_calibration(section: AprilTagSection, plane: Plane) -> Iterator[Finding]:
    """Yield findings about the positions of the floor tags, and about a lens that they estimate.

    An error above POSITION_ERROR_MAX_MM is a warning, and one above MISFIT_MM or NaN is a problem.
    """
    if not plane.error_max_mm <= POSITION_ERROR_MAX_MM:  # true for NaN, too
        yield (
            not plane.error_max_mm <= MISFIT_MM,
            f"the floor tags are up to {plane.error_max_mm:.1f} mm away from their places in "
            "lab.camera.floor: measure the tags again, and correct their fields at, size_mm "
            "and heading",
        )
    if section.lens is None and plane.lens_error_mm > POSITION_ERROR_MAX_MM:
        yield (
            plane.lens_error_mm > MISFIT_MM,
            "the floor tags do not determine the lens well, so that robots may be located "
            f"{plane.lens_error_mm:.0f} mm off: tilt the camera more, or set lab.camera.lens",
        )


def _is_unexplained(ratio: float, side_px: float, size_mm: float, distance_mm: float) -> bool:
    """Decide whether neither noise, print scale nor tag height explains the size of a robot's tag.

    Args:
        ratio: The measured side divided by `size_mm`.
        side_px: The side in the image [px].
        size_mm: The side in the spec [mm].
        distance_mm: Height of the camera above the tag [mm].
    """
    noise = CORNER_PX / math.sqrt(2) / side_px  # of a side that is fitted to four corners
    return abs(ratio - 1) > SIZE_SDS * noise + SIZE_SD_MM / size_mm + HEIGHT_SD_MM / distance_mm


def _describe_tags(numbers: Sequence[int]) -> str:
    """Format tag numbers as the subject of a sentence: "tag 3 is", or "tags 3, 4 are"."""
    if len(numbers) > 1:
        return f"tags {_join_numbers(numbers)} are"
    return f"tag {_join_numbers(numbers)} is"


def _join_numbers(numbers: Sequence[int]) -> str:
    """Join tag numbers with commas, in the order given. "none" if there are none."""
    return ", ".join(map(str, numbers)) or "none"


class AprilTagCamera(PictureCamera[Seen]):
    """A camera that tracks N robots by their AprilTags; see `tetractl.core.protocols.Camera`.

    A robot is untracked while its tag is not seen, is seen twice, or has the wrong size. No robot
    is tracked before the floor tags have calibrated the camera.

    Args:
        section: The fields of the camera in the spec.
        setup: The constants of the experiment.
        clock: The clock for times.
        wake: Called after every new frame.
        join: Opens a source in memory; see `PictureCamera`. None for the spec's source.
    """

    def __init__(
        self,
        section: AprilTagSection,
        setup: Setup,
        clock: Clock,
        wake: Callable[[], None] = lambda: None,
        join: OpenMemorySource | None = None,
    ) -> None:
        super().__init__(section, clock, wake, join)
        self.section = section
        self._tracker = Tracker(section, setup.names, setup.metres)

    def _health(self, searches: Sequence[PictureSearch[Seen]]) -> Health:
        """Check the floor, the tags and the lens: problems, warnings and facts."""
        section = self.section
        floor = self._tracker.floor
        problems: list[str] = []
        warnings: list[str] = []
        plane = floor.plane or floor.misfit
        for is_problem, message in _check_tags(section, self._tracker, searches):
            (problems if is_problem else warnings).append(message)
        blurs = drop_none(search.result.blur for search in searches)
        sides = drop_none(search.result.side_px for search in searches)
        if blurs and statistics.median(blurs) > BLUR_MAX:
            warnings.append(
                f"tags look too small or blurred, the smallest is {min(sides):.0f} px wide: "
                "focus the lens, use larger tags or more pixels, or shorten the exposure"
            )
        facts = {"latency": f"{section.latency:g} s, as the spec says"}
        if plane is not None:
            origin = "the spec's" if section.lens is not None else "estimated"
            facts["floor_error"] = f"{plane.error_mm:.2f} mm"
            facts["focal_length"] = f"{plane.focal_px:.0f} px, {origin}"
        if sides:
            facts["smallest_tag"] = f"{min(sides):.0f} px"
        return Health(tuple(problems), tuple(warnings), facts)

    def _see(self, picture: GreyImage, exposed_ns: int) -> Seen:
        """Find the robots' tags in an image. `exposed_ns` is not used."""
        return self._tracker.track_image(picture)
