"""Disturbances of commands: time for planning, and delays and losses of the radio."""

from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import Field

from tetractl.core.clock import SECOND
from tetractl.core.setup import Setup
from tetractl.plant.disturbances.spells import Spells, SpellsSection
from tetractl.spec.base import Fraction
from tetractl.spec.disturbance import DelayedCommand, Disturbance, DisturbanceSection


class RadioSection(DisturbanceSection):
    """A disturbance: commands by radio are delayed, and lost at random for each robot."""

    type: Literal["radio"]
    delay: float = Field(default=0.0, ge=0, le=10, allow_inf_nan=False)
    """Time from sending a transmission until the robots receive it [s]."""
    jitter: float = Field(default=0.0, ge=0, le=10, allow_inf_nan=False)
    """Maximum additional delay of a transmission, uniformly distributed [s]."""
    spread: float = Field(default=0.0, ge=0, le=10, allow_inf_nan=False)
    """Maximum additional delay of a robot [s].

    It is uniformly distributed and sampled for each robot once per trial.
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
        robots: Number of robots.
        rng: Generator of delays and losses.
    """

    def __init__(self, section: RadioSection, robots: int, rng: np.random.Generator) -> None:
        self._section = section
        self._rng = rng
        self._late_ns = None  # without a spread, no random number is drawn
        if section.spread > 0:
            self._late_ns = np.rint(section.spread * SECOND * rng.random(robots)).astype(np.int64)

    def sent(self, command: DelayedCommand) -> DelayedCommand:
        """Delay a transmission, and remove the robots that lose it from those that receive it.

        The random delay (`jitter`) is the same for all robots, and new in each transmission. Each
        robot's own delay (`spread`) stays the same for the whole trial. Robots that an earlier
        disturbance excluded stay excluded.
        """
        section = self._section
        chances = self._rng.random(1 + command.reached.size)  # of the delay, then of each robot
        delay_s = section.delay + section.jitter * float(chances[0])
        late_ns = command.late_ns
        if late_ns is None:
            late_ns = self._late_ns
        elif self._late_ns is not None:
            late_ns = late_ns + self._late_ns
        return replace(
            command,
            due_ns=command.due_ns + round(delay_s * SECOND),
            reached=command.reached & (chances[1:] >= section.loss),
            late_ns=late_ns,
        )


class SilentRadioSection(SpellsSection):
    """A disturbance of the radio: in some intervals, no robot receives a command.

    Robots then keep following the last command that they received.

    A watchdog (`wheels.watchdog`) may stop them.
    """

    type: Literal["silent-radio"]

    def build(self, setup: Setup, rng: np.random.Generator) -> "SilentRadio":
        """Create the disturbance that this section of the spec describes, for one trial."""
        return SilentRadio(self.draw(rng))


class SilentRadio(Disturbance):
    """A disturbance that loses every command sent during some intervals."""

    def __init__(self, spells: Spells) -> None:
        self._spells = spells

    def sent(self, command: DelayedCommand) -> DelayedCommand:
        """Return the command, which reaches no robot while the radio is silent."""
        if not self._spells.include(command.sent_ns / SECOND):
            return command
        return replace(command, reached=np.zeros_like(command.reached))


class PlanningTimeSection(DisturbanceSection):
    """A disturbance: planning takes a random time, after which the command is sent."""

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
