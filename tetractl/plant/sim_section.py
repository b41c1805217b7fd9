"""The fields `plant: {type: sim}` of a spec, which describe a simulation, and their checks.

`simulation.py` has the plant itself, which a command that only reads specs does not import.
"""

from collections.abc import Callable, Iterator
from pkgutil import resolve_name
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from tetractl.core.clock import Clock, VirtualClock
from tetractl.core.protocols import LabSupervision, Plant
from tetractl.core.registries import DISTURBANCES, MOTIONS
from tetractl.core.setup import Setup
from tetractl.model.cell_numbers import DIPOLE_SD_RAD, DRIFT_UM_S
from tetractl.spec.base import (
    Fraction,
    Model,
    NonNegative,
    NonNegativeAngle,
    Positive,
    inconsistent,
)
from tetractl.spec.disturbance import DisturbanceSection
from tetractl.spec.plant import PlantSection
from tetractl.spec.registry_fields import KindName, KindSection
from tetractl.spec.yaml.problems import Loc

POSES_MAX = 2_000_000
"""Maximum number of true poses in a control period, for all robots together.

They are kept in memory until the period ends.
"""


class MeasurementNoise(Model):
    """Standard deviations of the normally distributed errors of each camera frame."""

    position: NonNegative = 0.0
    """Standard deviation of x and of y [length unit]."""
    heading: NonNegativeAngle = 0.0
    """Standard deviation of the heading [rad]."""


class WheelDriveSection(Model):
    """The wheels of simulated robots, and how their host sends wheel speeds.

    The defaults describe ideal wheels.
    """

    rate: Positive | None = None
    """Transmissions per second while a direction is held [Hz].

    Each new direction is sent at once. By default, there are no further transmissions.
    """
    recompute: bool = True
    """Whether the host computes the wheel speeds of each transmission from the newest frame. If
    not, it repeats the wheel speeds of the control step.
    """
    lead: NonNegative | None = None
    """How far ahead the host predicts the headings for which it computes wheel speeds [s], counted
    from sending the command. With `wheels.lag`, it predicts the headings in which robots would come
    to a standstill if they were stopped then. By default, it uses the measured headings.
    """
    count: Positive | None = None
    """Wheel speed of one count [length unit/s].

    Speeds are rounded to whole counts, and the rounding error is carried over to the next
    transmission. By default, they are not rounded.
    """
    dead_zone: Annotated[int, Field(ge=0, le=60)] = 0
    """Maximum count at which the host assumes that a wheel does not move. Needs `count`."""
    dead_zone_error: Annotated[int, Field(ge=0, le=60)] = 0
    """Maximum difference between a wheel's true dead zone and `dead_zone` [counts].

    The difference is a whole number, uniform in [-dead_zone_error, dead_zone_error].
    """
    gain_error: Fraction = 0.0
    """Each wheel's true speed is the speed sent times 1 + e, with e uniform in [-gain_error,
    gain_error], sampled once per trial.
    """
    radius_error: Fraction = 0.0
    """Each robot's true distance from wheel to centre is the spec's times 1 + e, with e uniform in
    [-radius_error, radius_error], sampled once per trial.
    """
    lag: NonNegative = 0.0
    """Time constant with which wheels follow a received command [s]."""


class CultureSection(Model):
    """Simulates the robots as swimming cells with the spec's turning rates and speeds.

    Their other properties are sampled at random; see
    packages/tetractl-microscope/docs/cells-explained.md. Cells turn by the paper's equation (3),
    and `heading_noise` is the random walk of their heading.
    """

    dipole: NonNegativeAngle = DIPOLE_SD_RAD
    """Standard deviation of the dipole's angle from a cell's axis [rad]."""
    drift: NonNegative = DRIFT_UM_S
    """Speed of the medium's flow [um/s]. Its direction is sampled once per trial."""
    walls: bool = True
    """Whether the arena's edges are walls, along which cells slide."""


class SimSection(PlantSection):
    """A simulated plant in virtual time.

    All disturbances are off by default, and depend only on the trial's seed.
    """

    simulated: ClassVar[bool] = True
    switches_field: ClassVar[bool] = True
    type: Literal["sim"] = "sim"
    motion: Annotated[str, KindName(MOTIONS)] = "exact"
    """The true motion.

    `exact` follows the paper's equations (1)-(3). `euler` moves by (4)-(6), on straight chords.
    Ignored with `drive`.
    """
    drive: WheelDriveSection | None = None
    """Wheels with which robots turn towards the direction.

    By default, robots turn by the paper's equation (3), without wheels. Needs the experiment's
    field `wheels`.
    """
    cells: CultureSection | None = None
    """Simulates swimming cells instead of points that move by `motion`, which is then ignored."""
    camera_rate: float = Field(default=120.0, ge=1, le=10_000, allow_inf_nan=False)
    """Number of camera frames per second [Hz]."""
    truth_rate: float = Field(default=960.0, ge=1, le=100_000, allow_inf_nan=False)
    """Sampling rate of the true path, from which errors and obstacle violations are computed [Hz].

    It is at least the camera rate.
    """
    measurement_noise: MeasurementNoise = MeasurementNoise()
    """Standard deviations of the camera's errors of measurement."""
    heading_noise: NonNegative = 0.0
    """Random walk of the true heading of robots that move [rad/sqrt(s)]."""
    dead_time: float = Field(default=0.0, ge=0, le=10, allow_inf_nan=False)
    """Time from the exposure of the frame used for a command or stop until the robots act on it
    [s], as in `controller.dead_time`. A command that is sent later acts at once. Delays of `drive`
    and `disturbances` are added.
    """
    lost_commands: Fraction = 0.0
    """Probability that a robot does not receive a command.

    It then keeps following the previous one, until a watchdog (`wheels.watchdog`) stops it.
    """
    a_error: Fraction = 0.0
    """The true turning rate a is the spec's times 1 + e, with e uniform in [-a_error, a_error],
    sampled once per trial and robot.
    """
    speed_error: Fraction = 0.0
    """The true speed is the spec's times 1 + e, with e uniform in [-speed_error, speed_error],
    sampled once per trial and robot.
    """
    disturbances: tuple[
        Annotated[DisturbanceSection, KindSection(DISTURBANCES, DisturbanceSection)], ...
    ] = Field(default=(), max_length=100)
    """Further disturbances. Each is applied to the result of the previous one."""

    def clock(self) -> Clock:
        """Return a new virtual clock for one simulated trial."""
        return VirtualClock()

    def build(
        self, setup: Setup, clock: Clock, seed: np.random.SeedSequence, supervision: LabSupervision
    ) -> Plant:
        """Create the simulation of one trial; see `PlantSection.build`."""
        make: Callable[..., Plant] = resolve_name("tetractl.plant.simulation:SimPlant")
        return make(self, setup, clock, seed)

    @model_validator(mode="after")
    def _truth_is_as_fine_as_the_camera(self) -> Self:
        if self.truth_rate < self.camera_rate:
            message = f"must be at least as high as camera_rate, {self.camera_rate:g}"
            raise inconsistent("truth_rate", message)
        return self

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield the field and message of each contradiction in the wheels or sampling rates."""
        poses = setup.period_s * max(self.truth_rate, self.camera_rate) * len(setup.names)
        if poses > POSES_MAX:
            message = f"gives {poses:.3g} poses in each control period of {setup.period_s:g} s"
            yield (
                ("truth_rate",),
                f"{message}, but at most {POSES_MAX:g} are allowed; lower the rate",
            )
        if self.drive is not None and self.cells is not None:
            yield (
                ("cells",),
                "cannot be combined with 'drive', because cells have no wheels; leave out one of "
                "the two",
            )
        if self.drive is not None and not setup.on_wheels:
            yield (
                ("drive",),
                "needs the radius of the wheels: add 'wheels: {radius: ..}' to the spec",
            )
        repeats_hz = None if self.drive is None else self.drive.rate
        transmissions_hz = repeats_hz or 1 / setup.period_s
        if transmissions_hz * setup.watchdog_s <= 1:
            message = f"the robots receive {transmissions_hz:g} commands per second, but their "
            message += f"watchdog of {setup.watchdog_s:g} s would stop them between two commands"
            yield ("drive",), f"{message}; shorten controller.period"

    @property
    def loses_frames(self) -> bool:
        """Whether any disturbance of the simulation loses camera frames."""
        return any(disturbance.loses_frames for disturbance in self.disturbances)

    @property
    def disturbed(self) -> bool:
        """Whether the plant differs in any way from the paper's equations (1)-(3).

        Errors of measurement count as a difference.
        """
        sizes = (
            self.measurement_noise.position,
            self.measurement_noise.heading,
            self.heading_noise,
            self.dead_time,
            self.lost_commands,
            self.a_error,
            self.speed_error,
        )
        other_robots = self.drive is not None or self.cells is not None
        return other_robots or bool(self.disturbances) or any(size > 0 for size in sizes)
