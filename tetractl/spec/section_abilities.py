"""What sections of controllers, plants and devices may have besides their interface, for checks and
predictions: ask by isinstance. A section of a plug-in has an ability if it has these fields.
"""

from typing import Protocol, runtime_checkable

from tetractl.spec.controller import OptimizerSection


@runtime_checkable
class OnPort(Protocol):
    """An actuator on the serial port with this name."""

    port: str


@runtime_checkable
class Addressed(Protocol):
    """A camera at an address, whose messages come `latency` [s] after their exposure."""

    @property
    def address(self) -> str:
        """Its port or computer."""
        ...

    @property
    def latency(self) -> float:
        """Time from an exposure until its message comes [s]."""
        ...


@runtime_checkable
class PlansSignals(Protocol):
    """A controller whose plans hold at most `horizon_max` signals."""

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
    """A controller that searches plans by an optimiser."""

    optimizer: OptimizerSection


@runtime_checkable
class GivenDirections(Protocol):
    """A controller that decides nothing: it sends the directions [rad] of its spec."""

    directions: tuple[float, ...]


@runtime_checkable
class Estimating(Protocol):
    """A controller that, if `estimate`, identifies robots and dead time while it drives."""

    estimate: bool


class Clearance(Protocol):
    """The distance that plans keep to obstacles: `margin` besides the `radius` of a robot [length
    unit]; the least `separation` of two robots [length unit]; whether an `adaptive` margin gives
    way, and whether it is kept to `walls` too."""

    radius: float
    margin: float
    separation: float
    adaptive: bool
    walls: bool


@runtime_checkable
class KeepsClear(Protocol):
    """A controller whose plans keep a distance to obstacles."""

    collision: Clearance


class KnownNoise(Protocol):
    """The stated deviations of a measured position [length unit] and heading [rad], 0 if
    unknown."""

    position_noise: float
    heading_noise: float


@runtime_checkable
class Accepting(Protocol):
    """A controller that goes on, within its time, while it expects a total error above the one that
    it accepts [length unit]."""

    accept_error: float
    prior: KnownNoise


@runtime_checkable
class Delaying(Protocol):
    """A plant with a stated time from a command to its effect [s]."""

    dead_time: float


class MeasurementErrors(Protocol):
    """Standard deviations of a measured position [length unit] and heading [rad]."""

    position: float
    heading: float


@runtime_checkable
class Noisy(Protocol):
    """A plant with stated disturbances: the largest relative errors of turning rate and speed, the
    random walk of the heading [rad/sqrt(s)], and the errors of measurements."""

    a_error: float
    speed_error: float
    heading_noise: float
    measurement_noise: MeasurementErrors
