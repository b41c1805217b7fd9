"""Poses of robots, and records of what a camera measures.

    Pose           position and heading of one robot
    Poses          the same for N robots, in arrays
    Sight          the precision and the frame rate of a camera
    CameraFrame    the poses in one frame of a lab's camera; robots may be missing
    Observation    the poses that a controller receives; a missing robot has its last pose
    Sample         the record of a frame in a log: the observation, true poses in a simulation, and
                   messages
    FrameAddition  messages that a camera adds to its frames
    Frames         the frames of a trial, or of a part of it, in arrays

All coordinates are in the spec's length unit, headings and angles in rad.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from tetractl.core import elementwise
from tetractl.core.clock import SECOND
from tetractl.core.elementary import hypot

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Integers = NDArray[np.int64]
Times = Integers
"""Times [ns]."""
GreyImage = NDArray[np.uint8]
"""An image in shades of grey, shape (height, width)."""

POSE_MAX = 1e9
"""Maximum absolute value of coordinates [length unit] and headings [rad] that a log can hold."""
CAMERA_TOPICS = "/camera/"
"""Prefix of the log topics on which a camera adds messages to its frames.

Such messages are logged unchanged, and nothing depends on them.
"""
PICTURE_TOPIC = f"{CAMERA_TOPICS}picture"
"""Log topic of a camera's images, in the message type `CompressedImage` of Foxglove."""
BACKGROUND_TOPIC = f"{CAMERA_TOPICS}background"
"""Log topic of the images of the empty scene, with which a camera compares its other images."""


@dataclass(frozen=True, slots=True)
class Pose:
    """Position and heading of one robot in the plane.

    Attributes:
        x: x [length unit].
        y: y [length unit].
        heading: Heading, anticlockwise from +x [rad].
        height: Height of the tracked body's origin above the floor [length unit]. None if the
            camera cannot measure it.
        tilt: Angle between the body's own upward axis and the vertical [rad], from 0 to pi. None if
            the camera cannot measure it.
    """

    x: float
    y: float
    heading: float
    height: float | None = None
    tilt: float | None = None

    def distance_to(self, other: "Pose") -> float:
        """Compute the distance between the positions of two poses [length unit]."""
        return hypot(self.x - other.x, self.y - other.y)


@dataclass(frozen=True, slots=True)
class Poses:
    """Positions and headings of N robots in the plane, as arrays.

    Attributes:
        x: x of each robot [length unit], shape (N,).
        y: y of each robot [length unit], shape (N,).
        heading: Heading of each robot, anticlockwise from +x and not wrapped [rad], shape (N,).
    """

    x: Floats
    y: Floats
    heading: Floats

    @classmethod
    def from_array(cls, array: Floats) -> Self:
        """Create poses from an array of shape (N, 3): x, y [length unit] and heading [rad]."""
        x, y, heading = array.T
        return cls(np.ascontiguousarray(x), np.ascontiguousarray(y), np.ascontiguousarray(heading))

    def array(self) -> Floats:
        """Return the poses as an array of shape (N, 3): x, y [length unit] and heading [rad]."""
        array = np.empty((len(self.x), 3))
        array[:, 0] = self.x
        array[:, 1] = self.y
        array[:, 2] = self.heading
        return array

    @property
    def xy(self) -> Floats:
        """The positions of the robots as one array, shape (N, 2)."""
        return np.array([self.x, self.y]).T

    def distances(self, points: Floats) -> Floats:
        """Compute the distance of each robot to its own point [length unit], shape (N,).

        Args:
            points: x and y of one point for each robot, shape (N, 2).
        """
        return elementwise.hypot(self.x - points[:, 0], self.y - points[:, 1])


def wrap(angles: Floats) -> Floats:
    """Wrap angles [rad] into the range from -pi to pi. NaN stays NaN."""
    return angles - 2 * np.pi * np.rint(angles / (2 * np.pi))


def describe_excess_angle(angle: float) -> tuple[str, str] | None:
    """Describe the problem of an angle of more than a whole turn, which is probably in degrees.

    Args:
        angle: The angle [rad].

    Returns:
        The problem and a hint. None if the angle is not larger than a whole turn.
    """
    if not abs(angle) > 2 * math.pi:
        return None
    return (
        "is more than a whole turn, which is 6.283 rad",
        f"if this is an angle in degrees, write {math.radians(angle):.4g}",
    )


@dataclass(frozen=True, slots=True)
class CameraFrame:
    """One frame of a camera in the lab: the poses of N robots in the spec's coordinates.

    Most cameras measure all poses at the same time, and `exposed_ns` is empty. Robots that measure
    their own poses do so one after another. Then `exposed_ns` holds the time of each pose, and
    `sampled_ns` is the latest of them. A pose that is no newer than in the previous frame keeps
    its time.

    Attributes:
        number: Number of the frame.
        sampled_ns: Time of exposure on the run's clock [ns].
        received_ns: Time of arrival at the host on the run's clock [ns].
        poses: Pose of each robot, N entries. None if a robot is untracked.
        unknown_objects: Poses of tracked bodies that are not robots.
        fault: Why the poses must not be used. Empty if they can be used.
        exposed_ns: Time at which each pose was measured [ns], N entries, or empty.
    """

    number: int
    sampled_ns: int
    received_ns: int
    poses: tuple[Pose | None, ...]
    unknown_objects: tuple[Pose, ...] = ()
    fault: str = ""
    exposed_ns: tuple[int, ...] = ()

    def times(self, last_ns: Sequence[int]) -> tuple[int, ...]:
        """Return the time at which each pose was measured [ns], N entries.

        If robots measure their own poses, a time never goes back: an untracked robot, or one whose
        pose arrives late, keeps its previous time.

        Args:
            last_ns: The times of the previous poses [ns], N entries.
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
    """The precision and the frame rate with which a camera measures robots. 0 means unknown.

    A camera may measure on a grid, for example if robots read their positions from a printed mat.
    The standard deviations then do not include the error of the grid.

    Attributes:
        grid_mm: Step of measured positions [mm].
        grid_rad: Step of measured headings [rad].
        noise_mm: Standard deviation of a measured position [mm].
        noise_rad: Standard deviation of a measured heading [rad].
        rate_hz: Frames per second [Hz].
    """

    grid_mm: float = 0.0
    grid_rad: float = 0.0
    noise_mm: float = 0.0
    noise_rad: float = 0.0
    rate_hz: float = 0.0

    @property
    def has_grid(self) -> bool:
        """Whether the camera measures on a grid. The pose of a moving robot may then repeat."""
        return self.grid_mm > 0 or self.grid_rad > 0

    @property
    def largest_error_mm(self) -> float:
        """The maximum error of a measured position [mm].

        It is four standard deviations of the noise, plus the distance from a grid point to the
        corner of its square.
        """
        return self.grid_mm / math.sqrt(2) + 4 * self.noise_mm

    @property
    def largest_error_rad(self) -> float:
        """The maximum error of a measured heading [rad].

        It is four standard deviations of the noise, plus half a step of the grid.
        """
        return self.grid_rad / 2 + 4 * self.noise_rad

    @property
    def pose_std(self) -> tuple[float, float, float]:
        """Standard deviations of x, y [mm] and heading [rad] that noise and the grid cause.

        The error of a grid is uniform, so its variance is a twelfth of the step squared.
        """
        position_std_mm = hypot(self.noise_mm, self.grid_mm / math.sqrt(12))
        return (
            position_std_mm,
            position_std_mm,
            hypot(self.noise_rad, self.grid_rad / math.sqrt(12)),
        )


UNKNOWN_SIGHT = Sight()
"""The `Sight` of a camera whose precision and rate are unknown."""


@dataclass(frozen=True, slots=True)
class Observation:
    """What a controller receives from a camera frame: measured poses, with their times.

    The arrays are shared with the log and therefore read-only.

    Attributes:
        frame: Number of the frame.
        sampled_ns: Time of exposure on the trial's clock [ns].
        received_ns: Time of arrival at the host on the trial's clock [ns].
        poses: Measured poses. An untracked robot keeps its last pose.
        valid: Whether each robot is tracked in this frame, shape (N,).
        exposed_ns: Time at which each pose was measured [ns], N entries, none after `sampled_ns`.
            Empty if all were measured at `sampled_ns`.
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
        """The times at which the poses were measured, on the trial's clock [s], shape (N,)."""
        times = self.exposed_ns or (self.sampled_ns,) * len(self.valid)
        return np.array(times) / SECOND


@dataclass(frozen=True, slots=True)
class FrameAddition:
    """Messages that a camera adds to one of its frames, besides the poses.

    Attributes:
        sampled_ns: When the frame was exposed [ns].
        messages: Messages for the log, each a topic and protobuf bytes. They are logged unchanged.
            The topics of images are PICTURE_TOPIC and BACKGROUND_TOPIC.
    """

    sampled_ns: int
    messages: tuple[tuple[str, bytes], ...] = ()


@dataclass(frozen=True, slots=True)
class Sample:
    """A camera frame as a log records it: the poses, whether they are valid, and the times.

    Attributes:
        observation: The measured poses.
        truth: The true poses at the exposure. None except in simulations.
        messages: The messages of the camera's `FrameAddition`.
    """

    observation: Observation
    truth: Poses | None
    messages: tuple[tuple[str, bytes], ...] = ()


class Frames(NamedTuple):
    """M camera frames of N robots, stored as arrays.

    Attributes:
        numbers: Number of each frame, shape (M,).
        sampled_ns: Time of each exposure [ns], shape (M,).
        received_ns: When each frame reached the host [ns], shape (M,).
        poses: Measured x, y [length unit] and heading [rad], shape (M, N, 3). An untracked robot
            keeps its last pose.
        valid: Whether each robot was tracked, shape (M, N).
        truth: True poses, shape (M, N, 3). None if they are unknown.
        exposed_ns: Time of each pose [ns], shape (M, N): usually the time of its frame.
    """

    numbers: Integers
    sampled_ns: Integers
    received_ns: Integers
    poses: Floats
    valid: Bools
    truth: Floats | None
    exposed_ns: Integers

    @classmethod
    def from_samples(cls, samples: Sequence[Sample], robots: int) -> "Frames":
        """Convert samples of frames to arrays.

        `truth` is None unless every sample has true poses. If there are no samples, `truth` is an
        empty array, so that `join` does not treat it as unknown.

        Args:
            samples: The samples, in order.
            robots: The number N of robots.
        """
        observations = [sample.observation for sample in samples]
        truths = [sample.truth for sample in samples if sample.truth is not None]
        has_all_truths = len(truths) == len(samples)
        exposed_ns = [
            observation.exposed_ns or (observation.sampled_ns,) * robots
            for observation in observations
        ]
        valid = [observation.valid for observation in observations]
        return cls(
            numbers=_to_integers([observation.frame for observation in observations]),
            sampled_ns=_to_integers([observation.sampled_ns for observation in observations]),
            received_ns=_to_integers([observation.received_ns for observation in observations]),
            poses=_stack_poses([observation.poses for observation in observations], robots),
            valid=np.array(valid, dtype=np.bool_).reshape(-1, robots),
            truth=_stack_poses(truths, robots) if has_all_truths else None,
            exposed_ns=_to_integers(exposed_ns).reshape(-1, robots),
        )

    @classmethod
    def join(cls, parts: Sequence["Frames"]) -> "Frames":
        """Join the frames of several parts of a trial, in order.

        `truth` is None if any part has no true poses.
        """
        columns: list[Any] = []
        for part_columns in zip(*parts, strict=True):
            is_known = all(column is not None for column in part_columns)
            columns.append(np.concatenate(part_columns) if is_known else None)
        return cls(*columns)

    def select(self, rows: slice | Integers) -> "Frames":
        """Return the frames in the given rows: a slice, or an array of indices."""
        columns: list[Any] = [None if column is None else column[rows] for column in self]
        return Frames(*columns)


def _stack_poses(poses: Sequence[Poses], robots: int) -> Floats:
    """Stack the poses of N robots at M times in an array (M, N, 3)."""
    rows: list[Floats] = []
    for pose in poses:
        rows += [pose.x, pose.y, pose.heading]
    return np.concatenate([[], *rows]).reshape(-1, 3, robots).transpose(0, 2, 1)


def _to_integers(values: Sequence[Any]) -> Integers:
    return np.array(values, dtype=np.int64)
