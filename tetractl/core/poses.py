"""Poses of robots, camera frames, observations, and the ellipse of a covariance."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

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
        found = np.empty((len(self.x), 3))
        found[:, 0], found[:, 1], found[:, 2] = self.x, self.y, self.heading
        return found

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


@dataclass(frozen=True, slots=True)
class CameraFrame:
    """A camera system's poses of N robots at one instant, in the spec's coordinates.

    `poses` has one entry per robot, None if a robot is not tracked. `sampled_ns` is the time of
    exposure and `received_ns` the time of arrival at the host, both on the run's clock. `strangers`
    are tracked bodies that are not robots. `fault` is the reason why the poses must not be used, ""
    if there is none.
    """

    number: int
    sampled_ns: int
    received_ns: int
    poses: tuple[Pose | None, ...]
    strangers: tuple[Pose, ...] = ()
    fault: str = ""


@dataclass(frozen=True, slots=True)
class Observation:
    """The newest camera frame at one instant, in the form that the controller gets.

    `sampled_ns` is the time of exposure and `received_ns` the time of arrival at the host, both on
    the trial's clock; `valid` (N,) is True for robots tracked in that frame. A robot that was
    not tracked keeps its last pose. The arrays cannot be written: they are shared with the log.
    """

    frame: int
    sampled_ns: int
    received_ns: int
    poses: Poses
    valid: Bools

    def __post_init__(self) -> None:
        for each in (self.poses.x, self.poses.y, self.poses.heading, self.valid):
            each.setflags(write=False)


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
