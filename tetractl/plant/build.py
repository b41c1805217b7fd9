"""Makes the plant a spec asks for."""

import numpy as np

from tetractl.clock import Clock
from tetractl.plant.lab import Hands, LabPlant
from tetractl.plant.protocol import Plant
from tetractl.plant.simulation import SimPlant
from tetractl.spec.experiment import Experiment
from tetractl.spec.lab import LabSpec


def build_plant(
    experiment: Experiment, clock: Clock, seed: np.random.SeedSequence, hands: Hands | None = None
) -> Plant:
    """Return the plant of an experiment; `seed` feeds a simulation's disturbances."""
    if isinstance(experiment.plant, LabSpec):
        return LabPlant(experiment, clock, hands or Hands())
    return SimPlant(experiment, clock, seed)
