"""Makes the plant a spec asks for."""

import numpy as np

from tetractl.core.clock import Clock
from tetractl.core.protocols import Plant
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.lab import LabSpec
from tetractl.plant.lab import Hands, LabPlant
from tetractl.plant.simulation import SimPlant


def build_plant(
    experiment: Experiment, clock: Clock, seed: np.random.SeedSequence, hands: Hands | None = None
) -> Plant:
    """Return the plant of an experiment; `seed` feeds a simulation's disturbances."""
    if isinstance(experiment.plant, LabSpec):
        return LabPlant(experiment, clock, hands or Hands())
    return SimPlant(experiment, clock, seed)
