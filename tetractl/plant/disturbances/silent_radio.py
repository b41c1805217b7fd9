"""`{type: silent-radio}`: nothing that is sent reaches any robot for a while."""

from dataclasses import replace
from typing import Literal

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.setup import Setup
from tetractl.experiment.disturbance import DelayedCommand, Disturbance
from tetractl.plant.disturbances.spells import Spells, SpellsSection


class SilentRadioSection(SpellsSection):
    """Intervals in which no robot receives anything; robots go on with the last command."""

    type: Literal["silent-radio"]

    def build(self, setup: Setup, rng: np.random.Generator) -> "SilentRadio":
        """Return the silences of one trial."""
        return SilentRadio(self.draw(rng))


class SilentRadio(Disturbance):
    """Loses everything that is sent in an interval."""

    def __init__(self, spells: Spells) -> None:
        self._spells = spells

    def sent(self, command: DelayedCommand) -> DelayedCommand:
        """Return the command, which reaches no robot while the radio is silent."""
        if not self._spells.at(command.sent_ns / SECOND):
            return command
        return replace(command, reached=np.zeros_like(command.reached))
