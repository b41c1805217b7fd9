"""Where robots are, and what of it a camera shows.

    Pose           where one robot is, and in which direction it heads
    Poses          the same of N robots, in arrays
    Sight          how well a camera sees robots
    CameraFrame    what a camera of the lab shows at one instant; robots may be missing in it
    Observation    what a controller gets of a frame: each robot has a pose, if it is missing the
                   last one
    Sample         what a log keeps of a frame: the observation, true poses in a simulation, and
                   messages
    FrameAddition  such messages, as a camera has them with its frames

All coordinates are in the spec's length unit, headings and angles in rad.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from tetractl.core import elementwise
from tetractl.core.clock import SECOND
from tetractl.core.elementary import hypot

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Integers = NDArray[np.int64]
Times = Integers  # [ns]
Grey = NDArray[np.uint8]  # a picture (height, width)

POSE_MAX = 1e9
"""Limit of coordinates [length unit] and headings [rad]: logs hold no others."""


@dataclass(frozen=True, slots=True)
class Pose:
    """Where one robot is: x, y [length unit], and its heading, anticlockwise from +x [rad].

    `height` is the height of the tracked body's origin above the floor [length unit], `tilt` the
    angle between the body's own upward axis and the vertical [rad, 0 to pi]; each is None if the
    camera cannot measure it.
    """

    x: float
    y: float
    heading: float
    height: float | None = None
    tilt: float | None = None

    def distance_to(self, place: "Pose") -> float:
        """Return the distance between two positions [length unit]."""
        return hypot(self.x - place.x, self.y - place.y)


@dataclass(frozen=True, slots=True)
class Poses:
    """Where N robots are: x, y [length unit] and headings, anticlockwise from +x and not wrapped
    [rad], (N,) each."""

    x: Floats
    y: Floats
    heading: Floats

    @classmethod
    def of(cls, array: Floats) -> Self:
        """Return poses from an array of shape (N, 3): x, y, heading."""
        x, y, heading = array.T
        return cls(np.ascontiguousarray(x), np.ascontiguousarray(y), np.ascontiguousarray(heading))

    def array(self) -> Floats:
        """Return the poses as an array of shape (N, 3): x, y, heading."""
        array = np.empty((len(self.x), 3))
        array[:, 0] = self.x
        array[:, 1] = self.y
        array[:, 2] = self.heading
        return array

    @property
    def xy(self) -> Floats:
        """Positions, shape (N, 2)."""
        return np.array([self.x, self.y]).T

    def distances(self, points: Floats) -> Floats:
        """Return the distances (N,) of the robots to `points` (N, 2), one point for each robot."""
        return elementwise.hypot(self.x - points[:, 0], self.y - points[:, 1])


def wrap(angles: Floats) -> Floats:
    """Return angles [rad] wrapped into [-pi, pi]."""
    return angles - 2 * np.pi * np.rint(angles / (2 * np.pi))


def turn_problem(angle: float) -> tuple[str, str] | None:
    """Return what is wrong with an angle [rad] of more than a whole turn, which is probably in
    degrees, and a hint; None for other angles."""
    if not abs(angle) > 2 * math.pi:
        return None
    return (
        "is more than a whole turn, 6.283 rad",
        f"if these are degrees, write {math.radians(angle):.4g}",
    )


@dataclass(frozen=True, slots=True)
class CameraFrame:
    """What a camera of the lab shows of N robots at one instant, in the spec's coordinates.

    `poses` has one entry per robot, None if a robot is not tracked. `sampled_ns` is the time of
    exposure and `received_ns` the time of arrival at the host, both on the run's clock. `strangers`
    are tracked bodies that are not robots. `fault` is the reason why the poses must not be used, ""
    if there is none.

    A camera exposes all poses at once, and then `exposed_ns` is empty. Robots that measure their
    poses themselves do so one by one: `exposed_ns` (N,) are the times of the poses, and
    `sampled_ns` is the latest of them. A pose that is no newer than in the frame before has the
    same time again.
    """

    number: int
    sampled_ns: int
    received_ns: int
    poses: tuple[Pose | None, ...]
    strangers: tuple[Pose, ...] = ()
    fault: str = ""
    exposed_ns: tuple[int, ...] = ()

    def times(self, last_ns: Sequence[int]) -> tuple[int, ...]:
        """Return the times (N,) of the poses [ns], given those of the poses before, `last_ns` (N,).

        Of robots that measure their own poses, a time never goes back: one that is not tracked
        keeps the last time, and so does one whose pose comes late.
        """
        if not self.exposed_ns:
            return (self.sampled_ns,) * len(self.poses)
        times = list(last_ns)
        for robot, pose in enumerate(self.poses):
            if pose is not None:
                times[robot] = max(self.exposed_ns[robot], last_ns[robot])
        return tuple(times)


@dataclass(frozen=True, slots=True)
class Sight:
    """How well a camera sees robots, as far as it is known: 0 is for not known.

    `noise_mm` and `noise_rad` are the standard deviations of a measured position [mm] and heading
    [rad], `rate_hz` is the number of frames a second. A camera may measure on a grid, as robots do
    that read a printed mat: then it shows positions in steps of `grid_mm` [mm] and headings in
    steps of `grid_rad` [rad], and the deviations are those without the grid.
    """

    grid_mm: float = 0.0
    grid_rad: float = 0.0
    noise_mm: float = 0.0
    noise_rad: float = 0.0
    rate_hz: float = 0.0

    @property
    def coarse(self) -> bool:
        """Whether a pose may repeat to the last bit while its robot moves."""
        return self.grid_mm > 0 or self.grid_rad > 0

    @property
    def largest_error_mm(self) -> float:
        """The largest error of a position [mm]: to a corner of the grid's square, and noise."""
        return self.grid_mm / math.sqrt(2) + 4 * self.noise_mm

    @property
    def largest_error_rad(self) -> float:
        """The largest error of a heading [rad]."""
        return self.grid_rad / 2 + 4 * self.noise_rad

    @property
    def spread(self) -> tuple[float, float, float]:
        """Standard deviations of x, y [mm] and heading [rad], by noise and grid: the error of a
        grid is uniform, so that its variance is a twelfth of the step's square."""
        mm = hypot(self.noise_mm, self.grid_mm / math.sqrt(12))
        return mm, mm, hypot(self.noise_rad, self.grid_rad / math.sqrt(12))


UNSTATED = Sight()
"""What is known of a camera that says nothing."""


@dataclass(frozen=True, slots=True)
class Observation:
    """What a controller gets of a camera frame, the newest one at some instant.

    `frame` is its number, `sampled_ns` the time of exposure and `received_ns` the time of arrival
    at the host, both on the trial's clock. `valid` (N,) is True for robots that are tracked in the
    frame; another one keeps its last pose. `exposed_ns` (N,) are the times of the poses if each has
    its own, none of them after `sampled_ns`; else it is empty.

    The log shares the arrays: they are made read-only.
    """

    frame: int
    sampled_ns: int
    received_ns: int
    poses: Poses
    valid: Bools
    exposed_ns: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        for array in (self.poses.x, self.poses.y, self.poses.heading, self.valid):
            array.setflags(write=False)

    @property
    def seconds(self) -> Floats:
        """The times (N,) of the poses [s]."""
        times = self.exposed_ns or (self.sampled_ns,) * len(self.valid)
        return np.array(times) / SECOND


@dataclass(frozen=True, slots=True)
class FrameAddition:
    """What a camera knows of the frame that it exposed at `sampled_ns`, beyond its poses.

    `messages`, each a topic and protobuf bytes, are logged as they are; a camera may use the
    channels of pictures, `log.format.channels`.
    """

    sampled_ns: int
    messages: tuple[tuple[str, bytes], ...] = ()


@dataclass(frozen=True, slots=True)
class Sample:
    """What a log keeps of a camera frame.

    `truth` are the true poses at its exposure, None outside simulations; `messages` are those of
    the camera's `FrameAddition`.
    """

    observation: Observation
    truth: Poses | None
    messages: tuple[tuple[str, bytes], ...] = ()
