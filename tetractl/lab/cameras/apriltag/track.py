"""One picture in, the robots' planar poses out."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tetractl.core.poses import Floats, Grey, Pose
from tetractl.lab.cameras.apriltag.detect import Detector, Sighting
from tetractl.lab.cameras.apriltag.floor import MM, SQUARE, Floor
from tetractl.lab.cameras.apriltag.section import AprilTagSection, RobotTag

ODD_SIZE = 0.2  # a tag whose size differs by this fraction is another one, or at another height
_MODEL = SQUARE[:, 0] + 1j * SQUARE[:, 1]


@dataclass(frozen=True, slots=True)
class Seen:
    """The tags found in one picture.
    `poses` has one entry per robot, None if it is not tracked, and `strangers` those of unknown
    tags, as if they lay on the floor; both in the spec's unit. `tags` are the numbers of all tags,
    as often as each was seen. `sizes` are measured sides over `size_mm` by robot, if seen.
    `blur` is the largest blur of a wanted tag's edges in modules, `side_px` the shortest side of
    one; None without wanted tags.
    """

    poses: tuple[Pose | None, ...]
    strangers: tuple[Pose, ...]
    tags: tuple[int, ...]
    sizes: tuple[float | None, ...]
    blur: float | None
    side_px: float | None


class Tracker:
    """Finds the tags of robots in pictures; `metres` is the length of the spec's unit."""

    def __init__(self, section: AprilTagSection, names: Sequence[str], metres: float) -> None:
        self.robots = section.ordered(names)
        self._on_floor = {tag.tag for tag in section.floor}
        self._wanted = self._on_floor | {robot.tag for robot in self.robots}
        self._metres = metres
        self._detector = Detector()
        highest = max(robot.height_mm for robot in self.robots)
        self.floor = Floor(section.floor, metres, section.lens, highest)

    def see(self, picture: Grey) -> Seen:
        """Return what a grey picture (height, width) shows.

        A number that is seen twice is ignored: its robot is not tracked, its floor tag not used.
        """
        sightings = self._detector.find(picture)
        counts = Counter(each.tag for each in sightings)
        once = {each.tag: each for each in sightings if counts[each.tag] == 1}
        corners = {number: once[number].corners for number in once if number in self._on_floor}
        self.floor.see(corners, (picture.shape[1], picture.shape[0]))
        found = [self._robot(robot, once.get(robot.tag)) for robot in self.robots]
        wanted = [each for each in sightings if each.tag in self._wanted]
        return Seen(
            tuple(pose for pose, _ in found),
            self._strangers(sightings),
            tuple(sorted(each.tag for each in sightings)),
            tuple(size for _, size in found),
            max((8 * each.blur_px / each.side_px for each in wanted), default=None),
            min((each.side_px for each in wanted), default=None),
        )

    def _robot(
        self, robot: RobotTag, sighting: Sighting | None
    ) -> tuple[Pose | None, float | None]:
        plane = self.floor.plane
        if sighting is None or plane is None:
            return None, None
        corners = plane.locate(sighting.corners, robot.height_mm * MM)
        pose, side = self._posed(corners, robot.heading_offset)
        size = side / (robot.size_mm * MM)
        if abs(size - 1) >= ODD_SIZE:
            return None, size
        if (stance := plane.stance(sighting.corners, robot.size_mm * MM)) is not None:
            height, tilt = stance
            pose = replace(pose, height=height / self._metres, tilt=tilt)
        return pose, size

    def _strangers(self, sightings: Sequence[Sighting]) -> tuple[Pose, ...]:
        plane = self.floor.plane
        if plane is None:
            return ()
        unknown = (each for each in sightings if each.tag not in self._wanted)
        return tuple(self._posed(plane.locate(each.corners), 0.0)[0] for each in unknown)

    def _posed(self, corners: Floats, heading_offset: float) -> tuple[Pose, float]:
        """Return the pose, and the side [m], of the square that fits corners (4, 2) [m] best."""
        x, y = corners.mean(axis=0) / self._metres
        fit = np.vdot(_MODEL, corners[:, 0] + 1j * corners[:, 1]) / np.vdot(_MODEL, _MODEL).real
        heading = math.atan2(fit.imag, fit.real) + heading_offset
        return Pose(float(x), float(y), heading), float(abs(fit))
