"""Disturbances of the robots: errors of start pose, speed and turning rate, and sticking."""

from typing import Literal

import numpy as np

from tetractl.core import elementwise
from tetractl.core.poses import Floats, Poses
from tetractl.core.setup import Setup
from tetractl.plant.disturbances.spells import AlternatingStates
from tetractl.spec.base import Fraction, NonNegative, NonNegativeAngle, Positive
from tetractl.spec.disturbance import Disturbance, DisturbanceSection


class BatterySection(DisturbanceSection):
    """A disturbance: all robots slow down steadily for a time, and then keep the lower speed."""

    type: Literal["battery"]
    speed: Fraction
    """Fraction of its speed that each robot loses."""
    a: Fraction = 0.0
    """Fraction of its turning rate a that each robot loses."""
    over: Positive = 30.0
    """Time from the start of the trial over which the robots slow down [s]."""

    def build(self, setup: Setup, rng: np.random.Generator) -> "Battery":
        """Create the disturbance that this section of the spec describes, for one trial."""
        return Battery(self)


class Battery(Disturbance):
    """A disturbance that reduces turning rates a and speeds by fractions that grow with time."""

    def __init__(self, section: BatterySection) -> None:
        self._section = section

    def varied(self, a: Floats, speed: Floats, time_s: float) -> tuple[Floats, Floats]:
        """Reduce turning rates and speeds; see `Disturbance.varied`."""
        elapsed_fraction = min(1.0, time_s / self._section.over)
        return a * (1 - self._section.a * elapsed_fraction), speed * (
            1 - self._section.speed * elapsed_fraction
        )


class HeadingDriftSection(DisturbanceSection):
    """A disturbance: each robot also turns at a constant rate of its own.

    This turning is added to the turning by the paper's equation (3). The cause may be uneven
    wheels, or a bent cell.
    """

    type: Literal["heading-drift"]
    rate: NonNegative
    """Maximum turning rate [rad/s].

    Each robot's rate is uniform in [-rate, rate], sampled once per trial.
    """

    def build(self, setup: Setup, rng: np.random.Generator) -> "HeadingDrift":
        """Create the disturbance that this section of the spec describes, for one trial."""
        return HeadingDrift(self.rate * rng.uniform(-1, 1, len(setup.names)))


class HeadingDrift(Disturbance):
    """A disturbance that turns each moving robot at its own constant rate.

    Args:
        rates_rad_s: The turning rates [rad/s], shape (N,).
    """

    def __init__(self, rates_rad_s: Floats) -> None:
        self._rates_rad_s = rates_rad_s

    def moved(self, poses: Poses, moving: Floats, seconds: float, time_s: float) -> Poses:
        """Turn the robots by the drift; see `Disturbance.moved`."""
        return Poses(poses.x, poses.y, poses.heading + self._rates_rad_s * moving * seconds)


class StickingSection(DisturbanceSection):
    """A disturbance: each robot sometimes gets stuck, for example at a cable or on dust.

    Each robot gets stuck independently of the others.
    """

    type: Literal["sticking"]
    every: Positive
    """Mean time for which a robot moves before it gets stuck again [s], exponentially distributed.
    """
    duration: NonNegative = 0.5
    """Time for which a stuck robot neither moves nor turns [s]."""

    def build(self, setup: Setup, rng: np.random.Generator) -> "Sticking":
        """Create the disturbance that this section of the spec describes, for one trial."""
        return Sticking(self, len(setup.names), rng)


class Sticking(Disturbance):
    """A disturbance that makes each robot stick at random times, independently of the others.

    Args:
        section: The fields of the disturbance in the spec.
        n_robots: Number of robots.
        rng: Generator of the random times.
    """

    def __init__(self, section: StickingSection, n_robots: int, rng: np.random.Generator) -> None:
        self._sticking = AlternatingStates(
            n_robots, lambda: rng.exponential(section.every), lambda: section.duration
        )

    def varied(self, a: Floats, speed: Floats, time_s: float) -> tuple[Floats, Floats]:
        """Set the turning rates and speeds of stuck robots to 0; see `Disturbance.varied`."""
        is_free = self._sticking.advance(time_s)
        return a * is_free, speed * is_free


class WanderSection(DisturbanceSection):
    """A disturbance: turning rates a and speeds have relative errors that change slowly.

    The errors of each robot, and of its turning rate and speed, are independent of each other. The
    logarithm of each error is a stationary Ornstein-Uhlenbeck process.
    """

    type: Literal["wander"]
    a: NonNegative = 0.0
    """Standard deviation of the logarithm of the error of each turning rate a."""
    speed: NonNegative = 0.0
    """Standard deviation of the logarithm of the error of each speed."""
    time: Positive = 5.0
    """Correlation time of the errors [s]."""

    def build(self, setup: Setup, rng: np.random.Generator) -> "Wander":
        """Create the disturbance that this section of the spec describes, for one trial."""
        return Wander(self, len(setup.names), rng)


class Wander(Disturbance):
    """A disturbance that changes turning rates and speeds slowly and randomly.

    The statistics of the errors do not depend on how often `varied` is called.

    Args:
        section: The fields of the disturbance in the spec.
        n_robots: Number of robots.
        rng: Generator of the random errors.
    """

    def __init__(self, section: WanderSection, n_robots: int, rng: np.random.Generator) -> None:
        self._log_deviations = np.array([[section.a], [section.speed]])
        self._correlation_s = section.time
        self._rng = rng
        self._deviates = rng.standard_normal(
            (2, n_robots)
        )  # of a and speed, of standard deviation 1
        self._updated_s = 0.0  # the time of this state

    def varied(self, a: Floats, speed: Floats, time_s: float) -> tuple[Floats, Floats]:
        """Apply the present errors to turning rates and speeds; see `Disturbance.varied`."""
        correlation = elementwise.exp(-(time_s - self._updated_s) / self._correlation_s)
        self._updated_s = time_s
        new_deviates = self._rng.standard_normal(self._deviates.shape)
        self._deviates = (
            correlation * self._deviates + np.sqrt(1 - np.square(correlation)) * new_deviates
        )
        a_factor, speed_factor = elementwise.exp(self._log_deviations * self._deviates)
        return a * a_factor, speed * speed_factor


class StartErrorSection(DisturbanceSection):
    """A disturbance: in every trial, each robot starts at a random pose near its start pose."""

    type: Literal["start-error"]
    position: NonNegative = 0.0
    """Maximum error of x and of y, uniformly distributed [length unit]."""
    heading: NonNegativeAngle = 0.0
    """Maximum error of the heading, uniformly distributed [rad]."""

    def build(self, setup: Setup, rng: np.random.Generator) -> "StartError":
        """Create the disturbance that this section of the spec describes, for one trial."""
        return StartError(self, rng)


class StartError(Disturbance):
    """A disturbance that adds random errors to the start poses."""

    def __init__(self, section: StartErrorSection, rng: np.random.Generator) -> None:
        self._section = section
        self._rng = rng

    def placed(self, poses: Poses) -> Poses:
        """Add random errors to the start poses; see `Disturbance.placed`."""
        x, y, heading = self._rng.uniform(-1, 1, (3, poses.x.size))
        section = self._section
        return Poses(
            poses.x + section.position * x,
            poses.y + section.position * y,
            poses.heading + section.heading * heading,
        )
