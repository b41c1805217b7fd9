"""Makes the plant a spec asks for."""

import numpy as np

from tetractl.clock import Clock
from tetractl.plant.protocol import Plant
from tetractl.plant.simulation import SimPlant
from tetractl.spec.experiment import Experiment


def build_plant(experiment: Experiment, clock: Clock, seed: np.random.SeedSequence) -> Plant:
    """Return the plant of an experiment; `seed` feeds its disturbances."""
    return SimPlant(experiment, clock, seed)
