"""The seeds of a trial, all from the root seed of its batch."""

import numpy as np


def trial_seeds(root: int, trial: int) -> tuple[int, np.random.SeedSequence]:
    """Return the key of the controller's random numbers and the seed of the plant's disturbances.

    Children of SeedSequence(root) by spawn key (trial, purpose): a trial's numbers depend on
    neither the number of trials nor the order in which they run.
    """
    controller = np.random.SeedSequence(root, spawn_key=(trial, 0))
    plant = np.random.SeedSequence(root, spawn_key=(trial, 1))
    return int(controller.generate_state(1, np.uint64)[0]), plant
