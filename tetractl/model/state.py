"""Where the robots are: poses and observations, for every layer above."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


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
        """Take poses from an array of shape (N, 3): x, y, heading."""
        return cls(*(np.ascontiguousarray(column) for column in array.T))

    def array(self) -> Floats:
        """Return shape (N, 3): x, y, heading."""
        return np.column_stack([self.x, self.y, self.heading])

    @property
    def xy(self) -> Floats:
        """Positions, shape (N, 2)."""
        return np.column_stack([self.x, self.y])

    def distances(self, points: Floats) -> Floats:
        """Distance of each robot to its own point, points (N, 2); shape (N,)."""
        return np.hypot(*(self.xy - points).T)


def wrap(angles: Floats) -> Floats:
    """Bring angles [rad] into [-pi, pi]."""
    return angles - 2 * np.pi * np.round(angles / (2 * np.pi))


@dataclass(frozen=True, slots=True)
class Observation:
    """The newest camera frame at one instant.

    `sampled_ns` is when the cameras were exposed and `received_ns` when the host had the frame,
    both on the trial's clock; `valid` (N,) tells which robots were tracked in that frame.
    """

    frame: int
    sampled_ns: int
    received_ns: int
    poses: Poses
    valid: NDArray[np.bool_]
