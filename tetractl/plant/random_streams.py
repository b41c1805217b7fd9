"""The independent random streams of one simulated trial.

A stream depends only on the trial's seed and on its own number. Whatever one part of a simulation
samples therefore never changes what another part samples.

The numbers are part of the result, and so is the order in which a part samples from its stream. If
either changes, the same seed gives another trial, and older logs can no longer be verified. A new
stream gets a new number, and a number is never used again.
"""

from enum import IntEnum

import numpy as np


class RandomStream(IntEnum):
    """The numbers of the random streams, one for each part of a simulation that samples values.

    Each comment lists what is sampled from the stream, in order. N is the number of robots.

    Numbers from 104 to 999 are free.
    """

    CAMERA = 0
    """Errors of the measured poses: for each frame, N of x, then N of y, then N of the heading."""
    HEADINGS = 1
    """Random walk of the headings: N numbers for each frame.

    For robots with wheels, N numbers for each sample of the true path.
    """
    RADIO = 2
    """Lost commands: N numbers for each transmission except a stop."""
    PARAMETERS = 3
    """Errors of the true parameters, once per trial: N of the rate a, then N of the speed."""
    DISTURBANCES = 4
    """First stream of disturbances: the k-th one, k = 0, 1, ..., 99, uses stream 4 + k."""
    TRIAL_ROBOTS = 1000
    """The choice of the robots of a trial, once per trial (`tetractl.spec.trial_robots`)."""
    BODIES = 2**32 - 1
    """Constants of the robots' bodies in a trial, which are not parameters of the motion.

    For wheels: gains, dead zones and radii. For cells: all properties, then the noise of their
    swimming.
    """


def generator(seed: np.random.SeedSequence, number: int) -> np.random.Generator:
    """Create the random generator of the stream `number`, for the trial with the seed `seed`."""
    key = (*seed.spawn_key, number)
    return np.random.default_rng(np.random.SeedSequence(seed.entropy, spawn_key=key))
