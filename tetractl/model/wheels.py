"""Two-wheeled robots that move like cells, by the paper's equations (21)-(25).

`Drivetrains` converts between wheel speeds and motor counts, `WheelHost` computes the speeds that a
host sends, and `WheeledRobots` is the true motion. The emulated robots and the lab's actuator use
these classes. The simulation runs their compiled loops, see `model.motion.rolling`.

A wheel runs at gain * (|count| - dead zone), and stands still within the dead zone. One count turns
an m3pi at about 0.19 rad/s, too much to neglect. Therefore the rounding error is carried over to
the next command (error diffusion), so that the mean of the speeds sent is the requested speed.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tetractl.core.poses import Bools, Floats, Poses, Times
from tetractl.model.motion.rolling import (
    HEADING,
    LAG,
    LEFT,
    LEFT_TARGET,
    MOVES,
    RIGHT,
    RIGHT_TARGET,
    ROWS,
    STANDS_BELOW,
    TURNS,
    KnownRobots,
    SentRates,
    X,
    Y,
    count,
    note,
    roll,
    wish,
)

COUNT_MAX = 127
"""Maximum count of a wheel, because counts are sent as signed bytes."""
Counts = tuple[int, int]
"""Counts of one robot's two wheels, from -COUNT_MAX to COUNT_MAX."""
STOP: Counts = (0, 0)
"""The counts that stop both wheels of a robot."""
CountArray = NDArray[np.int64]


def compute_body_velocity(
    left_speed: Floats, right_speed: Floats, r: Floats | float
) -> tuple[Floats, Floats]:
    """Compute robots' speeds [length unit/s] and turning rates [rad/s] from their wheel speeds.

        dx/dt = (right + left) cos(heading) / 2                                         (21)
        dy/dt = (right + left) sin(heading) / 2                                         (22)
        dheading/dt = (right - left) / (2 r)                                            (23)

    Args:
        left_speed: Speed of the left wheels [length unit/s].
        right_speed: Speed of the right wheels [length unit/s].
        r: Distance from a wheel to the centre [length unit].
    """
    speed = (right_speed + left_speed) / 2
    turn_rate_rad_s = (right_speed - left_speed) / (2 * r)
    return speed, turn_rate_rad_s


@dataclass(frozen=True, slots=True)
class Drivetrains:
    """The wheels of N robots, as calibrated or as they truly are.

    Counts (2, N) are in the order of the motor channels; speeds (2, N) are left and right.

    Attributes:
        gain: Speed per count of left and right wheels [length unit/s per count], shape (2, N).
            Negative for a wheel that positive counts drive backwards.
        dead_zone: Largest count without motion, shape (2, N).
        limit: Largest count that is sent, shape (N,).
        swap: Whether the left wheel is connected to the second motor channel, shape (N,).
    """

    gain: Floats
    dead_zone: CountArray
    limit: CountArray
    swap: Bools

    def speeds(self, counts: CountArray) -> Floats:
        """Compute the speeds of left and right wheels [length unit/s] from motor counts, (2, N).

        A wheel whose count is within its dead zone stands still.
        """
        by_wheel = self._reorder_channels(counts)
        excess = np.maximum(np.abs(by_wheel) - self.dead_zone, 0)
        return self.gain * (np.sign(by_wheel) * excess)

    def counts(self, speeds: Floats, rounding_errors: Floats) -> tuple[CountArray, Floats]:
        """Convert wheel speeds to the counts to send, and the rounding errors to carry over.

        If a wheel would exceed the limit, both speeds are scaled equally, which keeps the path's
        curvature. A wheel of speed 0 gets the count 0. If both wheels stand still, nothing is
        carried over.

        Args:
            speeds: Wheel speeds [length unit/s], shape (2, N).
            rounding_errors: Rounding errors of the previous call [counts], shape (2, N).

        Returns:
            The counts, and the new rounding errors, each within 0.5.

        Raises:
            ValueError: If a speed is not finite.
        """
        if not np.isfinite(speeds).all():
            raise ValueError(f"wheel speeds must be finite, not {speeds.tolist()}")
        rounding_errors = rounding_errors.copy()
        count_excess = count(speeds, rounding_errors, self.gain, self.dead_zone, self.limit)
        by_wheel = (count_excess + np.sign(count_excess) * self.dead_zone).astype(np.int64)
        return self._reorder_channels(by_wheel), rounding_errors

    def _reorder_channels(self, counts: CountArray) -> CountArray:
        """Reorder counts from motor channels to wheels, or from wheels back to motor channels."""
        return np.where(self.swap, counts[::-1], counts) if self.swap.any() else counts


class WheelHost:
    """Computes the wheel speeds of N robots that all follow the same direction.

    Args:
        a: Turning rates [rad/s], shape (N,).
        speed: Speeds [length unit/s], shape (N,).
        radius: Distance from a wheel to the centre [length unit], shape (N,).
        lag_s: Time constant with which the wheels follow commands [s]. 0 to neglect it.
        drivetrains: The wheels as calibrated.
    """

    def __init__(
        self, a: Floats, speed: Floats, radius: Floats, lag_s: float, drivetrains: Drivetrains
    ) -> None:
        self.drivetrains = drivetrains
        self._known_robots = KnownRobots(a, speed, radius, lag_s)
        self._sent_rates = SentRates.none(a.size)
        self._rounding_errors = np.zeros((2, a.size))

    def compute_speeds(
        self,
        headings: Floats,
        direction: float,
        measured_ns: int,
        acts_ns: int,
        is_driving: bool = True,
    ) -> Floats:
        """Compute the wheel speeds (2, N) with which robots follow a direction; see `wish`.

        Args:
            headings: Measured headings [rad], shape (N,).
            direction: The direction u [rad].
            measured_ns: Time of the measurement [ns].
            acts_ns: When the command takes effect [ns].
            is_driving: Whether robots drive. If not, they turn on the spot.
        """
        robots = self._known_robots if is_driving else self._known_robots.turning()
        return wish(
            headings,
            np.full(headings.shape, direction),
            measured_ns,
            acts_ns,
            robots,
            self._sent_rates,
        )

    def assume_lag(self, lag_s: float) -> None:
        """Set the lag of the wheels [s] that the host assumes, starting with the next command."""
        self._known_robots = self._known_robots._replace(lag_s=lag_s)

    def counts(self, speeds: Floats) -> CountArray:
        """Compute the counts (2, N) to send for wheel speeds (2, N) [length unit/s].

        The next call corrects the rounding errors of this call.
        """
        counts, self._rounding_errors = self.drivetrains.counts(speeds, self._rounding_errors)
        return counts

    def record_sent(self, acts_ns: int, speeds: Floats) -> tuple[Floats, Floats]:
        """Record wheel speeds (2, N) that were sent and take effect at `acts_ns` [ns].

        Returns:
            The speeds [length unit/s] and turning rates [rad/s] of the robots, (N,) each.
        """
        if self._known_robots.lag_s > 0:
            self._sent_rates = self._sent_rates.with_room()
            note(self._sent_rates, acts_ns, speeds, self._known_robots.radius)
        return compute_body_velocity(speeds[0], speeds[1], self._known_robots.radius)


NO_NUMBERS = np.zeros((0, 0))
"""An empty array of random numbers, for robots whose headings have no random walk."""


class WheeledRobots:
    """The true motion of N robots on wheels that follow target speeds with a first-order lag.

    Attributes:
        body: The state of the robots, shape (ROWS, N); see `rolling.roll`. `pose`, `wheels` and
            `targets` are views of its rows.
        pose: x, y and heading, shape (3, N).
        wheels: The present speeds of left and right wheels [length unit/s], shape (2, N).
        targets: The speeds that the wheels follow [length unit/s], shape (2, N).
        radius: True distance from a wheel to the centre [length unit], shape (N,).

    Args:
        poses: The poses at the start.
        radius: True distance from a wheel to the centre [length unit].
        lag_s: Time constant of the wheels [s], for all robots or for each (N,). 0 for no lag.
        standstill_speed: A stopped robot stands still once its wheels are slower than this speed
            [length unit/s].
    """

    roll = staticmethod(roll)

    def __init__(
        self, poses: Poses, radius: Floats, lag_s: float | Floats, standstill_speed: float
    ) -> None:
        self.body = np.zeros((ROWS, radius.size))
        self.radius = radius
        self.pose = self.body[X : HEADING + 1]
        self.wheels = self.body[LEFT : RIGHT + 1]
        self.targets = self.body[LEFT_TARGET : RIGHT_TARGET + 1]
        self.body[LAG] = lag_s
        self.body[STANDS_BELOW] = standstill_speed
        self.poses = poses
        self.scale(np.ones(radius.size), np.ones(radius.size))

    @property
    def poses(self) -> Poses:
        """A copy of the present poses of all robots. Setting the poses moves the robots."""
        return Poses(*self.pose.copy())

    @poses.setter
    def poses(self, poses: Poses) -> None:
        self.body[X] = poses.x
        self.body[Y] = poses.y
        self.body[HEADING] = poses.heading

    def scale(self, turn_ratios: Floats, speed_ratios: Floats) -> None:
        """Set the ratios of true to ideal turning rates and speeds, for example for slip.

        The new ratios replace the ratios of the previous call.

        Args:
            turn_ratios: Ratios of the turning rates, shape (N,).
            speed_ratios: Ratios of the speeds, shape (N,).
        """
        self.body[TURNS] = turn_ratios / (2 * self.radius)
        self.body[MOVES] = speed_ratios / 2

    def drive(
        self,
        since_ns: int,
        times_ns: Times,
        has_swerve: Bools | None = None,
        swerve_rad: float = 0.0,
        deviates: Floats = NO_NUMBERS,
    ) -> Floats:
        """Advance the robots, and return x, y and heading (M, 3, N); see `rolling.roll`.

        Args:
            since_ns: The time of the present state [ns].
            times_ns: Times of the poses [ns], shape (M,).
            has_swerve: Whether the headings swerve at each time, shape (M,). None if they never
                swerve.
            swerve_rad: Standard deviation of a swerve [rad].
            deviates: Standard normal numbers for the swerves, one row for each time with a swerve.
        """
        has_swerve = np.zeros(times_ns.size, np.bool_) if has_swerve is None else has_swerve
        path = np.empty((times_ns.size, *self.pose.shape))
        self.roll(self.body, since_ns, times_ns, has_swerve, swerve_rad, deviates, path)
        return path
