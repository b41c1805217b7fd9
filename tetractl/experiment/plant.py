"""The plant's part of a spec: what stands behind the controller."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from tetractl.experiment.base import Fraction, Model, NonNegative, Positive, inconsistent
from tetractl.experiment.choice import Choice, OneOf
from tetractl.experiment.disturbance import DisturbanceSection
from tetractl.experiment.kinds import DISTURBANCES, MOTIONS


class MeasurementNoise(Model):
    """Standard deviations of what the camera measures, drawn anew in every frame."""

    position: NonNegative = 0.0
    """Of x and of y [length unit]."""
    heading: NonNegative = 0.0
    """Of the heading [rad]."""


class SimSpec(Model):
    """A simulated plant in virtual time. Every disturbance is off by default and is drawn from the
    trial's seed."""

    type: Literal["sim"] = "sim"
    motion: Annotated[str, OneOf(MOTIONS)] = "exact"
    """`exact` follows (1)-(3); `arc` holds the wheel speeds of (24)-(25) between two commands;
    `euler` moves by (4)-(6) themselves, on straight chords."""
    camera_rate: float = Field(default=120.0, ge=1, le=10_000, allow_inf_nan=False)
    """Measurements a second [Hz]."""
    truth_rate: float = Field(default=960.0, ge=1, le=100_000, allow_inf_nan=False)
    """Samples a second of the true path that decides errors and obstacle violations [Hz]; at least
    the camera rate."""
    measurement_noise: MeasurementNoise = MeasurementNoise()
    """What the camera adds to the true poses."""
    heading_noise: NonNegative = 0.0
    """Random walk of the true heading [rad/sqrt(s)]."""
    dead_time: float = Field(default=0.0, ge=0, le=10, allow_inf_nan=False)
    """From measurement to actuation [s]; a stop takes as long."""
    lost_commands: Fraction = 0.0
    """Probability that a command never arrives and the one before it stays in force."""
    a_error: Fraction = 0.0
    """The true a is the spec's times 1 + e, with e uniform in [-a_error, a_error], drawn once a
    trial and robot."""
    speed_error: Fraction = 0.0
    """As `a_error`, for the speed."""
    disturbances: tuple[Annotated[DisturbanceSection, Choice(DISTURBANCES)], ...] = Field(
        default=(), max_length=100
    )
    """Further disturbances, which act one after another."""

    @model_validator(mode="after")
    def _truth_is_as_fine_as_the_camera(self) -> Self:
        if self.truth_rate < self.camera_rate:
            message = f"must be at least camera_rate, {self.camera_rate:g}"
            raise inconsistent("truth_rate", message)
        return self


class Wheels(Model):
    """Geometry of a two-wheeled robot standing in for a cell, (21)-(25)."""

    radius: Positive
    """Distance r from a wheel to the robot's centre [length unit]."""
