"""A record of how far a robot moved in some time, along and across its heading.

A step has three parts in the robot's own axes: the distance along its heading, the distance across
it (positive to the left), and the angle that it turned (positive anticlockwise). A step that was
fitted to many poses also has the variance of each part.

    step = RobotStep.fit(times_s, places)
    step.motion / step.std                     each part of the motion in standard deviations

Lengths are in the caller's unit, angles in rad, times in ns.
"""

import math
from dataclasses import dataclass

import numpy as np

from tetractl.core import elementary
from tetractl.core.clock import SECOND
from tetractl.core.poses import Floats, Pose

PART_NAMES = ("along its heading", "sideways", "around")
"""Names of the three parts of a step, as messages use them."""
ZERO_VARIANCE = np.zeros(3)
"""The variance of a step between two poses. It is 0, because the poses have no stated noise."""


@dataclass(frozen=True, slots=True)
class RobotStep:
    """The motion of a robot from one time to another, in its own axes.

    Attributes:
        motion: Distance along the heading and across it [length unit], and angle turned [rad],
            shape (3,).
        variance: Variance of each part of `motion`, shape (3,).
        dt_ns: Duration of the step [ns]. 0 if it does not matter.
        until_ns: When the step ended [ns].
        robot: Index of the robot.
        start_pose: The pose at which the step began. None if the step was fitted to many poses.
    """

    motion: Floats
    variance: Floats
    dt_ns: int = 0
    until_ns: int = 0
    robot: int = 0
    start_pose: Pose | None = None

    @classmethod
    def from_poses(
        cls,
        start_pose: Pose,
        end_pose: Pose,
        *,
        dt_ns: int = 0,
        until_ns: int = 0,
        robot: int = 0,
    ) -> "RobotStep":
        """Compute the step between two poses, as if the robot drove on an arc.

        The distance along is the length of the arc. The distance across is the displacement across
        the robot's heading halfway. The displacement along the heading halfway is the chord of the
        arc, whose length is sin(h) / h of the arc's length, where h is half the angle turned. The
        angle turned is the shorter rotation to the later heading. It is wrong if the robot turned
        by more than half a turn, which may happen in a long gap between poses.

        Args:
            start_pose: The earlier pose.
            end_pose: The later pose.
            dt_ns: Time between the poses [ns].
            until_ns: Time of the later pose [ns].
            robot: Index of the robot.
        """
        turned_rad = math.remainder(end_pose.heading - start_pose.heading, math.tau)
        halfway_rad = start_pose.heading + turned_rad / 2
        dx = end_pose.x - start_pose.x
        dy = end_pose.y - start_pose.y
        cosine = elementary.cos(halfway_rad)
        sine = elementary.sin(halfway_rad)
        along = dx * cosine + dy * sine
        across = dy * cosine - dx * sine
        # in this order, as numpy.sinc did for earlier logs
        half_turn_rad = math.pi * (turned_rad / math.tau)
        chord_ratio = elementary.sin(half_turn_rad) / half_turn_rad if half_turn_rad else 1.0
        motion = np.array([along / chord_ratio, across, turned_rad])
        return cls(motion, ZERO_VARIANCE, dt_ns, until_ns, robot, start_pose)

    @classmethod
    def fit(cls, times_s: Floats, places: Floats) -> "RobotStep":
        """Fit straight lines to many poses over time, and return the step of one second.

        Args:
            times_s: Times, shape (n,) [s]. At least three.
            places: x, y [length unit] and unwrapped heading [rad] at each time, shape (n, 3).

        Returns:
            A step along and across the x axis. Its variance follows from the deviations of the
            poses from the lines.
        """
        centred_s = times_s - times_s.mean()
        sum_of_squares = np.square(centred_s).sum()
        slope = np.einsum("n,nk->k", centred_s, places) / sum_of_squares
        residuals = places - places.mean(axis=0) - centred_s[:, None] * slope
        variance = np.square(residuals).sum(axis=0) / (len(times_s) - 2) / sum_of_squares
        return cls(slope, variance, dt_ns=SECOND)

    @property
    def std(self) -> Floats:
        """The standard deviations of the three parts of `motion`, shape (3,)."""
        return np.sqrt(self.variance)
