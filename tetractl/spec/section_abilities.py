"""Protocols for optional abilities of controllers, plants and devices in a spec.

Checks and predictions test for an ability with isinstance. A section, also one of a plug-in, has an
ability if it has these fields.
"""

from typing import Protocol, runtime_checkable

from tetractl.spec.controller import OptimizerSection


@runtime_checkable
class OnPort(Protocol):
    """An actuator in the spec that is connected to a serial port of the computer."""

    port: str


@runtime_checkable
class Addressed(Protocol):
    """A camera at a network address or port, with a known delay of its frames."""

    @property
    def address(self) -> str:
        """The serial port or the computer at which the device is reached."""
        ...

    @property
    def latency(self) -> float:
        """Time from the exposure of a frame until its message arrives [s]."""
        ...


@runtime_checkable
class PlansSignals(Protocol):
    """A controller in the spec whose plans have at most `horizon_max` signals."""

    horizon_max: int


@runtime_checkable
class HoldsSignals(Protocol):
    """A controller that holds each signal of a plan for `signal_periods` control periods."""

    signal_periods: int


@runtime_checkable
class CountsSteps(Protocol):
    """A controller that ends a trial after `steps_max` control steps."""

    steps_max: int


@runtime_checkable
class Modelled(Protocol):
    """A controller or a plant that moves robots by a motion of this name."""

    motion: str


@runtime_checkable
class Searches(Protocol):
    """A controller in the spec that searches for plans with an optimiser."""

    optimizer: OptimizerSection


@runtime_checkable
class GivenDirections(Protocol):
    """A controller that decides nothing, but sends the directions [rad] of its spec."""

    directions: tuple[float, ...]


@runtime_checkable
class Estimating(Protocol):
    """A controller that, if `estimate` is True, identifies robots and dead time while it drives."""

    estimate: bool


class Clearance(Protocol):
    """The distances that plans keep to obstacles, walls and other robots.

    Attributes:
        radius: Radius of a robot [length unit].
        margin: Distance in addition to the radius [length unit].
        separation: Minimum distance between the centres of two robots [length unit].
        adaptive: Whether the margin is reduced where it would leave no path.
        walls: Whether the margin is also kept to the walls of the arena.
    """

    radius: float
    margin: float
    separation: float
    adaptive: bool
    walls: bool


@runtime_checkable
class KeepsClear(Protocol):
    """A controller with plans that keep a distance to obstacles."""

    collision: Clearance


class KnownNoise(Protocol):
    """The standard deviations of measured positions and headings that a spec gives.

    Attributes:
        position_noise: Standard deviation of a position [length unit]. 0 if unknown.
        heading_noise: Standard deviation of a heading [rad]. 0 if unknown.
    """

    position_noise: float
    heading_noise: float


@runtime_checkable
class Accepting(Protocol):
    """A controller that keeps driving while it expects a total error above the one that it accepts.

    Attributes:
        accept_error: The total error that it accepts [length unit].
        prior: The measurement noise that it assumes.
    """

    accept_error: float
    prior: KnownNoise


@runtime_checkable
class Delaying(Protocol):
    """A plant whose spec gives the time from a command to its effect [s]."""

    dead_time: float


class MeasurementErrors(Protocol):
    """Standard deviations of a measured position [length unit] and heading [rad]."""

    position: float
    heading: float


@runtime_checkable
class Noisy(Protocol):
    """A plant in the spec with some random disturbances.

    Attributes:
        a_error: Maximum relative error of the turning rate.
        speed_error: Maximum relative error of the speed.
        heading_noise: Random walk of the heading [rad/sqrt(s)].
        measurement_noise: Errors of the measurements.
    """

    a_error: float
    speed_error: float
    heading_noise: float
    measurement_noise: MeasurementErrors
