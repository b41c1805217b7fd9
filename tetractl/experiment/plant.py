"""The plant's part of a spec: the simulation or the lab that is controlled."""

from abc import abstractmethod
from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np

from tetractl.core.clock import Clock
from tetractl.core.errors import UsageError
from tetractl.core.protocols import LabSupervision, Plant
from tetractl.core.setup import Setup
from tetractl.experiment.base import Model, Positive
from tetractl.experiment.choice import Choice, FoundRobots
from tetractl.experiment.yaml.problems import Loc


class PlantSection(Model):
    """A plant and its parameters; the sections themselves are in the files of their plants."""

    type: Any  # each section's own name, as a Literal
    simulated: ClassVar[bool]
    """Whether the plant repeats itself from its seed, in virtual time."""
    switches_field: ClassVar[bool] = False
    """Whether the plant can be steered with the field off, by a direction of None."""

    @property
    def loses_frames(self) -> bool:
        """Whether camera frames may be lost on the way, so that gaps in a log are no damage."""
        return not self.simulated

    @property
    def planning_max_s(self) -> float:
        """Longest time from a simulated control step's frame to its command [s]."""
        return 0.0

    @abstractmethod
    def clock(self) -> Clock:
        """Return a new clock of the kind that the plant runs on."""

    def require_devices(self) -> None:
        """Raise AbortError if a device of a lab is not there; quick, nothing is opened."""

    @abstractmethod
    def build(
        self, setup: Setup, clock: Clock, seed: np.random.SeedSequence, supervision: LabSupervision
    ) -> Plant:
        """Return the plant of one trial; `seed` feeds a simulation's disturbances.

        Only real robots need `supervision`.
        """

    def find(
        self,
        choice: Choice,
        setup: Setup,
        clock: Clock,
        seed: np.random.SeedSequence,
        supervision: LabSupervision,
    ) -> FoundRobots:
        """Return the robots that a trial may choose from; `setup` is that of stand-ins."""
        raise UsageError(f"a plant of type {self.type} has no robots to choose from")

    @property
    def disturbed(self) -> bool:
        """Whether a simulation has any disturbance; only then is it compared with real robots."""
        return False

    def bounds(self) -> dict[str, str]:
        """Return the bounds of a trial on this plant for display, {name: text}."""
        return {}

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield where the section contradicts the experiment or itself, and how.

        Places are within the section.
        """
        yield from ()


class Wheels(Model):
    """Geometry of a two-wheeled robot standing in for a cell, (21)-(25)."""

    radius: Positive
    """Distance r from a wheel to the robot's centre [length unit]."""
    watchdog: Positive | None = None
    """Time after which a robot that hears nothing stops by itself [s], as the m3pi firmware does
    after 0.25; by default it goes on for ever. It moves again with the next command that it
    hears."""
