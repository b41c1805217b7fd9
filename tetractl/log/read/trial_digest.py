"""The digest of a trial that was read from its log."""

import numpy as np

from tetractl.log.format.trial_digest import TrialDigest
from tetractl.log.read.trial_log import TrialLog


def trial_digest(trial: TrialLog) -> str:
    """Return the digest that the trial had as it ran; another one for a damaged log."""
    digest = TrialDigest(trial.start)
    numbers = np.column_stack([trial.frames, trial.mocap_ns, trial.received_ns])
    digest.frames(numbers, trial.mocap, trial.valid, trial.truth)
    for command in trial.commands:
        digest.command(command)
    for step in trial.steps:
        digest.step(step)
    for note in trial.notes:
        digest.note(note)
    return digest.hexdigest(trial.result)
