"""Batches in emulated labs in which nothing goes wrong, which must have nothing to report."""

from pathlib import Path

import tetractl
from tetractl.experiment.load import load_spec
from tetractl.experiment.plants import on_plant
from tetractl.results.flagged import Flagged, flagged

SEED = 71_930_412
TRIALS = 8


def flagged_trials(spec: Path, folder: Path, trials: int = TRIALS) -> list[Flagged]:
    """Run trials of a spec in its emulated lab; return those that a table would flag."""
    loaded = load_spec(spec, [f"trials.count={trials}", f"trials.seed={SEED}"])
    batch = tetractl.run_batch(on_plant(loaded, "emulated"), folder, jobs=1, progress=False)
    assert len(batch.trials) == trials
    return flagged(batch)
