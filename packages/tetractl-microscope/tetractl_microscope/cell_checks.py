"""Safety checks of cells in a lab: cells share one field, swim on without it, and wander.

A cell cannot be stopped: one that does not swim as commanded is warned of, one that leaves is lost,
and one that meets an obstacle swims on. Two cells that come too close end the run.

A cell's magnet does not lie along its axis. Under a field at the angle phi to its axis, a cell
whose magnet is off by d turns at the rate

    w = a sin(phi + d) = w0 cos d + a cos(phi) sin d,   w0 = a sin(phi),

where w0 is the commanded rate. The angle d of a cell is not known. Therefore every rate is allowed
that has |d| <= MAGNET_MAX_RAD, with the relative error RATE_SLACK.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from tetractl.core.guard_check import GuardCheck
from tetractl.core.guard_findings import Finding, Lose, RobotPlace, Warn
from tetractl.core.poses import Floats, Pose
from tetractl.lab.drift_check import DriftCheck
from tetractl.lab.guard_checks import GuardChecks
from tetractl.lab.guard_rules import GuardRules
from tetractl.lab.kernel import compute_edge_excess, distance_outside, drive_ahead, find_too_close
from tetractl.lab.motion_check import MotionCheck
from tetractl.model.swimmers import DIPOLE_SD_RAD

RATE_SLACK = 0.7
"""Relative error that is allowed for a cell's speed and turning rate.

Cells wander far more than wheels slip.
"""
POSITION_ERROR = 0.0
"""Assumed error of a cell's position [length unit].

It is neglected: the slack of `RATE_SLACK` is much larger.
"""
MAGNET_MAX_RAD = 3 * DIPOLE_SD_RAD
"""Maximum angle between a cell's magnet and its axis [rad]: three standard deviations."""
HEADING_ERROR_MAX_RAD = 0.06
"""Maximum error of a measured heading [rad].

It is four standard deviations of 0.0146 rad, which the headings in emulated pictures had (450
poses of three cells).
"""


def cell_checks(rules: GuardRules) -> GuardChecks:
    """Create the checks of the guard for a lab whose robots are cells."""
    swims = SwimCheck(rules)
    return GuardChecks((swims, StayCheck(rules)), DriftCheck(rules, swims), together=True)


class SwimCheck(MotionCheck):
    """The check of a cell's motion. It warns if a cell moves as no command explains.

    After a warning, the comparison with the commands starts again with the next pose.
    """

    def __init__(self, rules: GuardRules) -> None:
        super().__init__(rules, POSITION_ERROR, RATE_SLACK)
        self._names = rules.names
        self._a = np.array(rules.turning)
        self._slack[:, 2] += 2 * HEADING_ERROR_MAX_RAD

    def record_transmission(
        self, now_ns: int, speed: Sequence[float], turning: Sequence[float]
    ) -> None:
        """Record the rates that a transmission allows; see `GuardCheck.record_transmission`."""
        speeds = np.array(speed)
        slowest, fastest = compute_turning_rate_range(np.array(turning), self._a)
        speed_error = RATE_SLACK * np.abs(speeds)
        minimum = np.array(
            [speeds - speed_error, -speed_error, slowest - RATE_SLACK * np.abs(slowest)]
        ).T
        maximum = np.array(
            [speeds + speed_error, speed_error, fastest + RATE_SLACK * np.abs(fastest)]
        ).T
        self._commanded.add(now_ns, np.array([minimum, maximum]))

    def check_pose(self, robot: int, before: Pose, pose: Pose) -> Iterator[Finding]:
        """Warn of a pose that no command explains; see `GuardCheck.check_pose`.

        The comparison then restarts at this pose. Nothing is yielded for any other pose.
        """
        fault = self.compare_pose(robot, before, pose)
        if fault is not None:
            self.replace(robot)
            yield Warn(f"{self._names[robot]} {fault.text}")

    def check_pause(self, robot: int, before: Pose, pose: Pose, now_ns: int) -> tuple[Finding, ...]:
        """Report nothing, because cells swim on during a pause; see `GuardCheck.check_pause`."""
        return ()


def compute_turning_rate_range(commanded: Floats, a: Floats) -> tuple[Floats, Floats]:
    """Compute the minimum and maximum rate at which cells with a tilted magnet turn.

    Args:
        commanded: Turning rates of cells whose magnets lie along their axes, shape (N,) [rad/s].
        a: The cells' maximum turning rates, shape (N,) [rad/s].
    """
    along = commanded * math.cos(MAGNET_MAX_RAD)
    across = np.sqrt(np.maximum(np.square(a) - np.square(commanded), 0.0)) * math.sin(
        MAGNET_MAX_RAD
    )
    saturated_rate = a * math.cos(MAGNET_MAX_RAD)  # beyond it, some angle d gives the rate a
    minimum = np.where(commanded <= -saturated_rate, -a, along - across)
    maximum = np.where(commanded >= saturated_rate, a, along + across)
    return minimum, maximum


class StayCheck(GuardCheck):
    """A check that reports cells that leave the arena as lost, and aborts if two come too close."""

    def __init__(self, rules: GuardRules) -> None:
        self._rules = rules

    def check_places(self, robots: Sequence[RobotPlace]) -> Iterator[Finding]:
        """Yield a loss for each cell about to leave the arena, and aborts for close pairs.

        Cells that are lost or not tracked are skipped.
        """
        poses_now: dict[str, Pose] = {}
        poses_ahead: dict[str, Pose] = {}
        for i, robot in enumerate(robots):
            if robot.pose is None or robot.lost:
                continue
            name = self._rules.names[i]
            poses_now[name] = robot.pose
            poses_ahead[name] = drive_ahead(robot.pose, robot.way)
            if distance_outside(self._rules.arena, poses_ahead[name]) > distance_outside(
                self._rules.arena, robot.pose
            ):
                excess = compute_edge_excess(self._rules, i, poses_ahead[name])
                yield Lose(i, f"{name} is about to leave the arena", excess)
        yield from find_too_close(poses_now, poses_ahead, self._rules)
