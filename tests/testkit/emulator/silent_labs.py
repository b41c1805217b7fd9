"""Batches without faults in emulated labs, which must report nothing unusual."""

from pathlib import Path

import tetractl
from tetractl.log.read.reader import read_trial
from tetractl.spec.load import load_spec
from tetractl.spec.plants import select_plant
from tetractl.statistics.flagged import Flagged, flagged

SEED = 71_930_412
TRIALS = 8
MET = "has met another cell"
"""A warning of what does happen: cells of a dish swim into one another."""


def flagged_trials(spec: Path, folder: Path) -> list[Flagged]:
    """Run trials of a spec in its emulated lab; return those that a table would flag, except for
    cells that have met."""
    loaded = load_spec(spec, [f"trials.count={TRIALS}", f"trials.seed={SEED}"])
    batch = tetractl.run_batch(select_plant(loaded, "emulated"), folder, jobs=1, progress=False)
    assert len(batch.trials) == TRIALS
    return [log for log in flagged(batch) if not only_met(log)]


def only_met(log: Flagged) -> bool:
    """Whether a trial is flagged only since cells have met."""
    warnings = [note.text for note in read_trial(Path(log.log)).notes if note.level == "warning"]
    counted = len(log.notes) == 1 and "warning" in log.notes[0]
    return counted and all(MET in text for text in warnings)
