"""The rig of an experiment's lab, for the commands that use a lab without a trial."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tetractl.experiment.experiment import Experiment
    from tetractl.lab.rig import Rig


def rig_of(experiment: "Experiment") -> "Rig":
    """Return the rig of an experiment's lab, real or emulated, before its first trial."""
    from numpy.random import SeedSequence

    from tetractl.plant.lab_plant import RigSection

    lab = experiment.plant
    assert isinstance(lab, RigSection), "`on_plant` has chosen a lab"
    seed = SeedSequence(experiment.trials.seed)
    return lab.rig(experiment.setup, lab.clock(), seed, chosen=experiment.open)
