"""Poses of robots, camera frames, observations, and the ellipse of a covariance."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from tetractl.core.clock import SECOND

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Integers = NDArray[np.int64]
Times = Integers  # [ns]
Grey = NDArray[np.uint8]  # a picture (height, width)

POSE_MAX = 1e9
"""Limit of coordinates [length unit] and headings [rad]: logs hold no others."""


@dataclass(frozen=True, slots=True)
class Pose:
    """One robot's planar pose: x, y in the spec's length unit, heading in rad from +x.

    `height` is the height of the tracked body's origin above the floor [length unit], `tilt` the
    angle between the body's own upward axis and the vertical [rad, 0 to pi]; each is None if the
    camera cannot measure it.
    """

    x: float
    y: float
    heading: float
    height: float | None = None
    tilt: float | None = None


@dataclass(frozen=True, slots=True)
class Poses:
    """Planar poses of N robots.

    x, y in the spec's length unit, heading in rad anticlockwise from +x and not wrapped; each of
    shape (N,).
    """

    x: Floats
    y: Floats
    heading: Floats

    @classmethod
    def of(cls, array: Floats) -> Self:
        """Return poses from an array of shape (N, 3): x, y, heading."""
        return cls(*(np.ascontiguousarray(column) for column in array.T))

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
        return np.hypot(self.x - points[:, 0], self.y - points[:, 1])


def wrap(angles: Floats) -> Floats:
    """Return angles [rad] wrapped into [-pi, pi]."""
    return angles - 2 * np.pi * np.rint(angles / (2 * np.pi))


def turn_problem(angle: float) -> tuple[str, str] | None:
    """Return what is wrong with an angle [rad] of more than a whole turn, which is probably in
    degrees, and a hint; None for others.
    """
    if not abs(angle) > 2 * math.pi:
        return None
    said = "is more than a whole turn, 6.283 rad"
    return said, f"if these are degrees, write {math.radians(angle):.4g}"


@dataclass(frozen=True, slots=True)
class CameraFrame:
    """A camera system's poses of N robots at one instant, in the spec's coordinates.

    `poses` has one entry per robot, None if a robot is not tracked. `sampled_ns` is the time of
    exposure and `received_ns` the time of arrival at the host, both on the run's clock. `strangers`
    are tracked bodies that are not robots. `fault` is the reason why the poses must not be used, ""
    if there is none. If robots measure their poses themselves, `exposed_ns` (N,) are the times of
    the poses and `sampled_ns` the latest of them; a pose that is no newer than in the frame before
    has the same time again. It is empty if all poses are of one exposure.
    """

    number: int
    sampled_ns: int
    received_ns: int
    poses: tuple[Pose | None, ...]
    strangers: tuple[Pose, ...] = ()
    fault: str = ""
    exposed_ns: tuple[int, ...] = ()

    def times(self, last_ns: Sequence[int]) -> tuple[int, ...]:
        """Return the times (N,) of the poses [ns]; of robots that measure their own and are not
        tracked, or late, those of the poses before, `last_ns` (N,).
        """
        if not self.exposed_ns:
            return (self.sampled_ns,) * len(self.poses)
        rows = zip(self.poses, self.exposed_ns, last_ns, strict=True)
        return tuple(
            last if pose is None else max(exposed_ns, last) for pose, exposed_ns, last in rows
        )


@dataclass(frozen=True, slots=True)
class Sight:
    """What a camera can see of robots, as far as it is known; 0 where it is not.

    A camera that measures on a grid, as robots that read a printed mat do, shows positions in steps
    of `grid_mm` [mm] and headings in steps of `grid_rad` [rad]. `noise_mm` and `noise_rad` are
    standard deviations of one measurement without the grid, `rate_hz` is the number of frames a
    second.
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
    def largest(self) -> tuple[float, float]:
        """The largest errors of a position [mm] and a heading [rad]."""
        corner = self.grid_mm / math.sqrt(2)
        return corner + 4 * self.noise_mm, self.grid_rad / 2 + 4 * self.noise_rad

    @property
    def spread(self) -> tuple[float, float, float]:
        """Standard deviations of x, y [mm] and heading [rad], by noise and grid: the error of a
        grid is uniform, so that its variance is a twelfth of the step's square."""
        mm = math.hypot(self.noise_mm, self.grid_mm / math.sqrt(12))
        return mm, mm, math.hypot(self.noise_rad, self.grid_rad / math.sqrt(12))


UNSTATED = Sight()
"""What is known of a camera that says nothing."""


@dataclass(frozen=True, slots=True)
class Observation:
    """The newest camera frame at one instant, in the form that the controller gets.

    `sampled_ns` is the time of exposure and `received_ns` the time of arrival at the host, both on
    the trial's clock; `valid` (N,) is True for robots tracked in that frame. A robot that was
    not tracked keeps its last pose. `exposed_ns` (N,) are the times of the poses if each has its
    own, none of them after `sampled_ns`; else it is empty. The arrays cannot be written: they are
    shared with the log.
    """

    frame: int
    sampled_ns: int
    received_ns: int
    poses: Poses
    valid: Bools
    exposed_ns: tuple[int, ...] = ()

    @property
    def seconds(self) -> Floats:
        """The times (N,) of the poses [s]."""
        times = self.exposed_ns or (self.sampled_ns,) * len(self.valid)
        return np.array(times) / SECOND

    def __post_init__(self) -> None:
        for array in (self.poses.x, self.poses.y, self.poses.heading, self.valid):
            array.setflags(write=False)


@dataclass(frozen=True, slots=True)
class FrameAddition:
    """What a camera knows of the frame exposed at `sampled_ns` beyond its poses.

    `messages`, topic and protobuf bytes, are logged as they are; a camera may use the channels of
    pictures, `log.format.channels`.
    """

    sampled_ns: int
    messages: tuple[tuple[str, bytes], ...] = ()


@dataclass(frozen=True, slots=True)
class Sample:
    """One camera frame and the true poses at its exposure; `truth` is None outside simulations.

    `messages`, topic and bytes, are what its camera adds to the frame's record.
    """

    observation: Observation
    truth: Poses | None
    messages: tuple[tuple[str, bytes], ...] = ()


INSIDE = 0.95
"""The fraction of a normal distribution that lies in the ellipse that `ellipse` returns."""
DEVIATIONS = math.sqrt(-2 * math.log(1 - INSIDE))
"""Distance from the ellipse's centre to its edge, in standard deviations."""


def ellipse(covariance: Floats) -> tuple[float, float, float]:
    """Return the longer and the shorter half axis [length unit], and the angle of the longer [rad],
    of the ellipse that contains the fraction INSIDE of a normal distribution with `covariance` (2,
    2).
    """
    values, vectors = np.linalg.eigh(covariance)
    short, long = DEVIATIONS * np.sqrt(np.maximum(values, 0.0))
    angle = math.atan2(float(vectors[1, 1]), float(vectors[0, 1]))
    return float(long), float(short), math.remainder(angle, math.pi)
