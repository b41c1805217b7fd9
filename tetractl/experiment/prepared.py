"""What finds the robots of a trial before it begins, see `TrialRobots`."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tetractl.core.clock import Clock
from tetractl.core.protocols import LabSupervision, Plant
from tetractl.experiment.experiment import Experiment


@dataclass(frozen=True, slots=True)
class PreparedTrial:
    """An experiment with the robots that were found, and their plant."""

    experiment: Experiment
    plant: Plant


Prepare = Callable[[Experiment, Clock, np.random.SeedSequence, LabSupervision], PreparedTrial]
"""Finds the robots of a trial. The clock and the seed are the trial's; only real robots need the
supervision. UsageError if robots cannot be found on the experiment's plant, AbortError if they were
not found."""
