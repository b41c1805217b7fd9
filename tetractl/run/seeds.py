"""Every random number of a batch comes from one root seed, by trial and by purpose."""

import numpy as np


def trial_seeds(root: int, trial: int) -> tuple[int, np.random.SeedSequence]:
    """Return (key of the controller's draws, seed of the plant's disturbances) of one trial.

    Children of SeedSequence(root) by spawn key (trial, purpose): a trial's numbers depend on
    neither the number of trials nor the order in which they run.
    """
    controller = np.random.SeedSequence(root, spawn_key=(trial, 0))
    plant = np.random.SeedSequence(root, spawn_key=(trial, 1))
    return int(controller.generate_state(1, np.uint64)[0]), plant
