"""Disturbances of the robots: errors of start pose, speed and turning rate, and sticking."""

from typing import Literal

import numpy as np

from tetractl.core import elementwise
from tetractl.core.poses import Floats, Poses
from tetractl.core.setup import Setup
from tetractl.plant.disturbances.spells import ByTurns
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
    """A disturbance that reduces turning rate a and speed by fractions that grow with time."""

    def __init__(self, section: BatterySection) -> None:
        self._section = section

    def varied(self, a: Floats, speed: Floats, time_s: float) -> tuple[Floats, Floats]:
        """Reduce turning rate and speed by the fractions lost; see `Disturbance.varied`."""
        used = min(1.0, time_s / self._section.over)
        return a * (1 - self._section.a * used), speed * (1 - self._section.speed * used)


class HeadingDriftSection(DisturbanceSection):
    """A disturbance: each robot turns at a constant rate, in addition to the paper's (3).

    The cause may be uneven wheels, or a bent cell.
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
    """A disturbance that turns each moving robot at its own constant rate (N,) [rad/s]."""

    def __init__(self, rates: Floats) -> None:
        self._rates = rates

    def moved(self, poses: Poses, moving: Floats, seconds: float, time_s: float) -> Poses:
        """Turn the robots by the drift; see `Disturbance.moved`."""
        return Poses(poses.x, poses.y, poses.heading + self._rates * moving * seconds)


class StickingSection(DisturbanceSection):
    """A disturbance: each robot sometimes sticks, as at a cable or on dust.

    Each robot does so independently of the others.
    """

    type: Literal["sticking"]
    every: Positive
    """Mean time for which a robot moves before it sticks again [s], exponentially distributed."""
    duration: NonNegative = 0.5
    """Time for which a stuck robot neither moves nor turns [s]."""

    def build(self, setup: Setup, rng: np.random.Generator) -> "Sticking":
        """Create the disturbance that this section of the spec describes, for one trial."""
        return Sticking(self, len(setup.names), rng)


class Sticking(Disturbance):
    """A disturbance by which each robot sometimes gets stuck, independently of the others.

    Args:
        section: The fields of the disturbance in the spec.
        robots: Number of robots.
        rng: Generator of the random times.
    """

    def __init__(self, section: StickingSection, robots: int, rng: np.random.Generator) -> None:
        self._free = ByTurns(
            robots, lambda: rng.exponential(section.every), lambda: section.duration
        )

    def varied(self, a: Floats, speed: Floats, time_s: float) -> tuple[Floats, Floats]:
        """Set the turning rates and speeds of stuck robots to 0; see `Disturbance.varied`."""
        free = self._free.well(time_s)
        return a * free, speed * free


class WanderSection(DisturbanceSection):
    """A disturbance: turning rates a and speeds have relative errors that change slowly.

    They are independent for each robot and quantity. Their logarithms are stationary
    Ornstein-Uhlenbeck processes.
    """

    type: Literal["wander"]
    a: NonNegative = 0.0
    """Standard deviation of the logarithm of each turning rate a."""
    speed: NonNegative = 0.0
    """Standard deviation of the logarithm of each speed."""
    time: Positive = 5.0
    """Correlation time of the errors [s]."""

    def build(self, setup: Setup, rng: np.random.Generator) -> "Wander":
        """Create the disturbance that this section of the spec describes, for one trial."""
        return Wander(self, len(setup.names), rng)


class Wander(Disturbance):
    """A disturbance that changes turning rates and speeds slowly and randomly.

    The statistics do not depend on how often it is called.

    Args:
        section: The fields of the disturbance in the spec.
        robots: Number of robots.
        rng: Generator of the random errors.
    """

    def __init__(self, section: WanderSection, robots: int, rng: np.random.Generator) -> None:
        self._deviations = np.array([[section.a], [section.speed]])
        self._correlation_s = section.time
        self._rng = rng
        self._state = rng.standard_normal((2, robots))  # of a and speed, of standard deviation 1
        self._last_s = 0.0  # the time of this state

    def varied(self, a: Floats, speed: Floats, time_s: float) -> tuple[Floats, Floats]:
        """Apply the present errors to turning rates and speeds; see `Disturbance.varied`."""
        correlation = elementwise.exp(-(time_s - self._last_s) / self._correlation_s)
        self._last_s = time_s
        fresh = self._rng.standard_normal(self._state.shape)
        self._state = correlation * self._state + np.sqrt(1 - np.square(correlation)) * fresh
        a_factor, speed_factor = elementwise.exp(self._deviations * self._state)
        return a * a_factor, speed * speed_factor


class StartErrorSection(DisturbanceSection):
    """A disturbance: in every trial, each robot starts at a random pose around its start."""

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
        """Return the start poses of the robots with random errors added."""
        x, y, heading = self._rng.uniform(-1, 1, (3, poses.x.size))
        section = self._section
        return Poses(
            poses.x + section.position * x,
            poses.y + section.position * y,
            poses.heading + section.heading * heading,
        )
