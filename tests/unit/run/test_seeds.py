import numpy as np

from tetractl.run.spec_trial import trial_seeds


def test_no_two_trials_or_roots_or_purposes_share_numbers():
    keys = []
    plants = []
    for root in (0, 1, 2, 2**32, 2**64 - 1):
        for trial in range(200):
            key, seed = trial_seeds(root, trial)
            keys.append(key)
            plants.append(int(seed.generate_state(1, np.uint64)[0]))
    assert len({*keys, *plants}) == 2000


def test_the_numbers_never_change():
    """A log names its seed: another version must draw the same."""
    key, seed = trial_seeds(1, 0)
    assert key == 6651666526363356749
    assert np.random.default_rng(seed).integers(2**32) == 4005688706
