"""A record of how far a robot moved in some time, along and across its heading.

A step has three parts in the robot's own axes: the distance along its heading, the distance across
it (positive to the left), and the angle that it turned (positive anticlockwise). A step that was
fitted to many poses also has the variance of each part.

    step = RobotStep.fitted(times_s, places)
    step.motion / step.std                     each part of the motion in standard deviations

Lengths are in the caller's unit, angles in rad, times in ns.
"""

import math
from dataclasses import dataclass

import numpy as np

from tetractl.core import elementary
from tetractl.core.clock import SECOND
from tetractl.core.poses import Floats, Pose

PARTS = ("along its heading", "sideways", "around")
"""Names of the three parts, as messages use them."""
EXACT = np.zeros(3)
"""The variance of a step between two poses: 0, because its noise is not known to the step."""


@dataclass(frozen=True, slots=True)
class RobotStep:
    """The motion of a robot from one time to another, in its own axes.

    Attributes:
        motion: Shape (3,): along, across [length unit], turned [rad].
        variance: Shape (3,): the variance of each part.
        dt_ns: Duration [ns]. 0 if it does not matter.
        until_ns: When the step ended [ns].
        robot: Index of the robot.
        before: The pose at which the step began. None if it was not one pose.
    """

    motion: Floats
    variance: Floats
    dt_ns: int = 0
    until_ns: int = 0
    robot: int = 0
    before: Pose | None = None

    @classmethod
    def between(
        cls,
        before: Pose,
        pose: Pose,
        *,
        dt_ns: int = 0,
        until_ns: int = 0,
        robot: int = 0,
    ) -> "RobotStep":
        """Compute the step between two poses, as if the robot drove on an arc.

        `along` is the length of the arc, `across` the displacement across the heading halfway. The
        displacement along the heading halfway is the chord of the arc: sin(h) / h of its length,
        where h is half the angle turned. If the robot turned by more than half a turn, as may
        happen in a long gap, `turned` is the shorter rotation to the same heading, which is wrong.

        Args:
            before: The earlier pose.
            pose: The later pose.
            dt_ns: Time between the poses [ns].
            until_ns: Time of the later pose [ns].
            robot: Index of the robot.
        """
        turned = math.remainder(pose.heading - before.heading, math.tau)
        middle = before.heading + turned / 2
        dx = pose.x - before.x
        dy = pose.y - before.y
        cosine = elementary.cos(middle)
        sine = elementary.sin(middle)
        along = dx * cosine + dy * sine
        across = dy * cosine - dx * sine
        half = math.pi * (turned / math.tau)  # in this order, as numpy.sinc did for earlier logs
        chord = elementary.sin(half) / half if half else 1.0
        motion = np.array([along / chord, across, turned])
        return cls(motion, EXACT, dt_ns, until_ns, robot, before)

    @classmethod
    def fitted(cls, times_s: Floats, places: Floats) -> "RobotStep":
        """Fit straight lines to many poses over time, and return the step of one second.

        Args:
            times_s: Times, shape (n,) [s]. At least three.
            places: x, y [length unit] and heading [rad, not wrapped], shape (n, 3).

        Returns:
            A step along and across the x axis. Its variance follows from the scatter of the places
            about the lines.
        """
        centred_s = times_s - times_s.mean()
        spread = np.square(centred_s).sum()
        slope = np.einsum("n,nk->k", centred_s, places) / spread
        residuals = places - places.mean(axis=0) - centred_s[:, None] * slope
        variance = np.square(residuals).sum(axis=0) / (len(times_s) - 2) / spread
        return cls(slope, variance, dt_ns=SECOND)

    @property
    def std(self) -> Floats:
        """The standard deviations of distance along, distance across and angle, shape (3,)."""
        return np.sqrt(self.variance)
