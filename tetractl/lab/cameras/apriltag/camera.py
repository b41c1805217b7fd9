"""The `apriltag` camera: robots by their tags in pictures; its problems, warnings and facts."""

import math
import statistics
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tetractl.core.clock import Clock
from tetractl.core.commands import Health
from tetractl.core.poses import Floats, Grey, Pose
from tetractl.core.setup import Setup
from tetractl.lab.cameras.apriltag.detect import Detector, Sighting
from tetractl.lab.cameras.apriltag.floor import MISFIT_MM, MM, SQUARE, Floor, Plane
from tetractl.lab.cameras.apriltag.section import AprilTagSection, RobotTag
from tetractl.lab.cameras.pictures.looks import Look, rate_hz, search_ms, stream_lines
from tetractl.lab.cameras.pictures.picture_camera import PictureCamera

# a tag whose size differs by this fraction is a different tag, or at a different height
ODD_SIZE = 0.2
_MODEL = SQUARE[:, 0] + 1j * SQUARE[:, 1]


@dataclass(frozen=True, slots=True)
class Seen:
    """The tags found in one picture. `poses` has one entry per robot, None if not tracked;
    `strangers` are the poses of unknown tags, computed as if on the floor; both in the spec's unit.
    `tags` are the numbers of all tags, repeated if seen several times. `sizes` are the ratios of
    measured side to `size_mm` by robot, if seen. `blur` is the largest blur of the edges of robots'
    and floor tags [modules], `side_px` their shortest side; None without such tags.
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
        """Return the tags and poses found in a grey picture (height, width).

        A tag number that is seen twice is ignored: the robot is not tracked, the floor tag not
        used.
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


BLURRED = 0.36  # blur in modules from which on some tags cannot be read
ODD = 0.03  # relative difference from the spec's size that is reported
MISPLACED_MM = 3.0
DOUBTFUL_MM = 3.0
OFTEN = 0.5  # a tag seen in a smaller fraction of the pictures counts as not seen


@dataclass(frozen=True, slots=True)
class State:
    """The state of the camera besides its pictures; `ended` is why the source ended, "" while it is
    open.

    `rate_hz` is the declared rate, `size` the pictures' height and width, `plane` the calibrated
    floor, even if it does not fit the spec.
    """

    source: str
    ended: str
    now_ns: int
    rate_hz: float | None
    size: tuple[int, ...] | None
    plane: Plane | None
    damaged: int
    skipped: int


def health_of(
    section: AprilTagSection, robots: Sequence[RobotTag], looks: Sequence[Look[Seen]], state: State
) -> Health:
    """Return the health of a camera from its last pictures' results, oldest first."""
    problems, warnings = stream_lines(
        looks, state.source, state.ended, state.now_ns, state.rate_hz, state.damaged
    )
    seen, twice = _seen(looks)
    floor = [tag.tag for tag in section.floor]
    for each in (
        _floor_seen(floor, seen, twice),
        _floor_placed(state.plane, section.lens is None),
        _robots(robots, looks, seen, twice),
        _sharpness(looks),
    ):
        problems += each[0]
        warnings += each[1]
    return Health(tuple(problems), tuple(warnings), _facts(section, looks, state))


Lines = tuple[list[str], list[str]]
"""Problems and warnings."""


def _seen(looks: Sequence[Look[Seen]]) -> tuple[list[int], list[int]]:
    """Return the tags seen in most pictures, and the tags seen twice in any picture."""
    counts = Counter(tag for look in looks for tag in set(look.seen.tags))
    twice = {tag for look in looks for tag, n in Counter(look.seen.tags).items() if n > 1}
    return sorted(tag for tag, n in counts.items() if n >= OFTEN * len(looks)), sorted(twice)


def _floor_seen(floor: Sequence[int], seen: Sequence[int], twice: Sequence[int]) -> Lines:
    problems: list[str] = []
    if missing := [tag for tag in floor if tag not in seen]:
        problems.append(f"floor {_tags(missing)} not seen; tags seen: {_listed(seen)}")
    if double := [tag for tag in floor if tag in twice]:
        problems.append(f"floor {_tags(double)} seen twice: every number may be used once only")
    return problems, []


def _floor_placed(plane: Plane | None, estimated: bool) -> Lines:
    if plane is None:
        return [], []
    problems: list[str] = []
    warnings: list[str] = []
    if not plane.worst_mm <= MISPLACED_MM:  # also for NaN
        line = (
            f"the floor tags lie up to {plane.worst_mm:.1f} mm off where lab.camera.floor puts "
            "them: measure at, size_mm and heading again"
        )
        (warnings if plane.worst_mm <= MISFIT_MM else problems).append(line)
    if estimated and plane.doubt_mm > DOUBTFUL_MM:
        line = (
            f"the floor tags say too little about the lens: robots may be {plane.doubt_mm:.0f} mm "
            "off; tilt the camera more or set lab.camera.lens"
        )
        (problems if plane.doubt_mm > MISFIT_MM else warnings).append(line)
    return problems, warnings


def _robots(
    robots: Sequence[RobotTag],
    looks: Sequence[Look[Seen]],
    seen: Sequence[int],
    twice: Sequence[int],
) -> Lines:
    problems: list[str] = []
    warnings: list[str] = []
    for i, robot in enumerate(robots):
        sizes = [look.seen.sizes[i] for look in looks]
        measured = [size for size in sizes if size is not None]
        if robot.tag in twice:
            problems.append(f"{robot.name}: tag {robot.tag} is seen twice, so it is not tracked")
        elif robot.tag not in seen:
            problems.append(
                f"{robot.name}: tag {robot.tag} is not seen; tags seen: {_listed(seen)}"
            )
        elif measured and abs(size := statistics.median(measured) - 1) > ODD:
            line = (
                f"{robot.name}: its tag looks {abs(100 * size):.0f} % "
                f"{'larger' if size > 0 else 'smaller'} than it should: are size_mm and height_mm "
                "right?"
            )
            (problems if abs(size) >= ODD_SIZE else warnings).append(line)
    return problems, warnings


def _sharpness(looks: Sequence[Look[Seen]]) -> Lines:
    blurs = [look.seen.blur for look in looks if look.seen.blur is not None]
    sides = [look.seen.side_px for look in looks if look.seen.side_px is not None]
    if not blurs or statistics.median(blurs) <= BLURRED:
        return [], []
    return [], [
        f"tags are too small or blurred, {min(sides):.0f} px wide at least: focus the lens, use "
        "larger tags or more pixels, or shorten the exposure"
    ]


def _facts(section: AprilTagSection, looks: Sequence[Look[Seen]], state: State) -> dict[str, str]:
    facts = {"source": state.source, "latency": f"{section.latency:g} s, as the spec says"}
    if state.size is not None:
        facts["resolution"] = f"{state.size[1]}x{state.size[0]}"
    if (rate := rate_hz(looks)) is not None:
        facts["rate"] = f"{rate:.1f} Hz"
    if looks:
        facts["search"] = f"{search_ms(looks):.1f} ms"
    if (plane := state.plane) is not None:
        facts["floor_error"] = f"{plane.error_mm:.2f} mm"
        origin = "the spec's" if section.lens is not None else "estimated"
        facts["focal_length"] = f"{plane.focal_px:.0f} px, {origin}"
    sides = [look.seen.side_px for look in looks if look.seen.side_px is not None]
    if sides:
        facts["smallest_tag"] = f"{min(sides):.0f} px"
    facts["damaged"] = str(state.damaged)
    facts["skipped"] = str(state.skipped)
    return facts


def _tags(numbers: Sequence[int]) -> str:
    return f"tag{'s' * (len(numbers) > 1)} {_listed(numbers)} {'are' if len(numbers) > 1 else 'is'}"


def _listed(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers)) or "none"


class AprilTagCamera(PictureCamera[Seen]):
    """Tracks N robots by their tags; a `Camera`.

    A robot is not tracked (None) while its tag is not seen, is seen twice, or has the wrong size.
    No robot is tracked while the floor is unknown.
    """

    def __init__(
        self,
        section: AprilTagSection,
        setup: Setup,
        clock: Clock,
        wake: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(section, clock, wake)
        self.section = section
        self._tracker = Tracker(section, setup.names, setup.metres)

    def check(self) -> Health:
        """Examine some pictures and return the problems of source, floor and tags."""
        looks = self._look()
        floor = self._tracker.floor
        state = State(
            source=self.section.source_name,
            ended=self._ended,
            now_ns=self._clock.now(),
            rate_hz=None if self._feed is None else self._feed.rate_hz,
            size=self._size,
            plane=floor.plane or floor.misfit,
            damaged=self.damaged,
            skipped=self._skipped,
        )
        found = health_of(self.section, self._tracker.robots, looks, state)
        return replace(found, emulated=self.emulated)

    def _see(self, picture: Grey, exposed_ns: int) -> Seen:
        return self._tracker.see(picture)
