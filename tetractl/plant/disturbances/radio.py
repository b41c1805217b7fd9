"""Disturbances of commands: time for planning, and delays and losses of the radio."""

from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import Field

from tetractl.core.clock import SECOND
from tetractl.core.setup import Setup
from tetractl.plant.disturbances.spells import ActiveIntervals, IntervalsSection
from tetractl.spec.base import Fraction
from tetractl.spec.disturbance import DelayedCommand, Disturbance, DisturbanceSection


class RadioSection(DisturbanceSection):
    """A disturbance: the radio delays commands, and each robot misses some of them at random."""

    type: Literal["radio"]
    delay: float = Field(default=0.0, ge=0, le=10, allow_inf_nan=False)
    """Time from sending a transmission until the robots receive it [s]."""
    jitter: float = Field(default=0.0, ge=0, le=10, allow_inf_nan=False)
    """Maximum additional delay of a transmission, uniformly distributed [s]."""
    spread: float = Field(default=0.0, ge=0, le=10, allow_inf_nan=False)
    """Maximum additional delay of a robot [s].

    Each robot's delay is uniformly distributed and sampled once per trial.
    """
    loss: Fraction = 0.0
    """Probability that a robot does not receive a transmission."""

    def build(self, setup: Setup, rng: np.random.Generator) -> "Radio":
        """Create the disturbance that this section of the spec describes, for one trial."""
        return Radio(self, len(setup.names), rng)


class Radio(Disturbance):
    """A disturbance that delays each transmission, and decides which robots receive it.

    Args:
        section: The fields of the disturbance in the spec.
        n_robots: Number of robots.
        rng: Generator of delays and losses.
    """

    def __init__(self, section: RadioSection, n_robots: int, rng: np.random.Generator) -> None:
        self._section = section
        self._rng = rng
        self._robot_delays_ns = None  # without a spread, no random number is drawn
        if section.spread > 0:
            self._robot_delays_ns = np.rint(section.spread * SECOND * rng.random(n_robots)).astype(
                np.int64
            )

    def sent(self, command: DelayedCommand) -> DelayedCommand:
        """Delay a transmission, and decide which robots lose it.

        The random delay (`jitter`) is the same for all robots, and new in each transmission. Each
        robot's own delay (`spread`) stays the same for the whole trial. Robots that an earlier
        disturbance excluded stay excluded.
        """
        section = self._section
        chances = self._rng.random(1 + command.reached.size)  # of the delay, then of each robot
        delay_s = section.delay + section.jitter * float(chances[0])
        robot_delays_ns = command.late_ns
        if robot_delays_ns is None:
            robot_delays_ns = self._robot_delays_ns
        elif self._robot_delays_ns is not None:
            robot_delays_ns = robot_delays_ns + self._robot_delays_ns
        return replace(
            command,
            due_ns=command.due_ns + round(delay_s * SECOND),
            reached=command.reached & (chances[1:] >= section.loss),
            late_ns=robot_delays_ns,
        )


class SilentRadioSection(IntervalsSection):
    """A disturbance: during some intervals, no robot receives a command.

    The robots then keep following the last command that they received, until a watchdog
    (`wheels.watchdog`) stops them.
    """

    type: Literal["silent-radio"]

    def build(self, setup: Setup, rng: np.random.Generator) -> "SilentRadio":
        """Create the disturbance that this section of the spec describes, for one trial."""
        return SilentRadio(self.draw(rng))


class SilentRadio(Disturbance):
    """A disturbance that loses every command sent during some intervals."""

    def __init__(self, intervals: ActiveIntervals) -> None:
        self._intervals = intervals

    def sent(self, command: DelayedCommand) -> DelayedCommand:
        """Let the command reach no robot if it is sent while the radio is silent."""
        if not self._intervals.include(command.sent_ns / SECOND):
            return command
        return replace(command, reached=np.zeros_like(command.reached))


class PlanningTimeSection(DisturbanceSection):
    """A disturbance: planning takes a random time, and delays the command by this time."""

    type: Literal["planning-time"]
    least: float = Field(ge=0, le=10, allow_inf_nan=False)
    """Minimum planning time of a control step [s]."""
    spread: float = Field(default=0.0, ge=0, le=10, allow_inf_nan=False)
    """Maximum additional planning time of a control step, uniformly distributed [s]."""

    @property
    def planning_max_s(self) -> float:
        """The longest planning time that this disturbance can cause [s]."""
        return self.least + self.spread

    def build(self, setup: Setup, rng: np.random.Generator) -> "PlanningTime":
        """Create the disturbance that this section of the spec describes, for one trial."""
        return PlanningTime(self, rng)


class PlanningTime(Disturbance):
    """A disturbance that samples the planning time of each control step."""

    def __init__(self, section: PlanningTimeSection, rng: np.random.Generator) -> None:
        self._section = section
        self._rng = rng

    def planning_s(self, time_s: float) -> float:
        """Sample the planning time of one control step [s]."""
        return self._section.least + self._section.spread * self._rng.random()
