"""Finds the robots of a trial among the cells of a real or simulated dish."""

from collections.abc import Sequence

import numpy as np

from tetractl.core.clock import Clock
from tetractl.core.errors import UsageError
from tetractl.core.protocols import LabSupervision
from tetractl.core.setup import Setup
from tetractl.lab.rig import Rig
from tetractl.plant.lab_plant import RigSection
from tetractl.plant.random_streams import RandomStream, generator
from tetractl.plant.sim_section import SimSection
from tetractl.spec.experiment import Experiment
from tetractl.spec.plants import PreparedTrial
from tetractl_microscope.choice.candidate import RobotCandidate
from tetractl_microscope.choice.choosing import chosen_from, settled
from tetractl_microscope.choice.dish_abilities import SettlesRobots, tracker_of
from tetractl_microscope.choice.scattered_cells import scattered_cells
from tetractl_microscope.choice.section import choice_of
from tetractl_microscope.choice.turn_field import turn_field


def prepare(
    experiment: Experiment,
    clock: Clock,
    seed: np.random.SeedSequence,
    supervision: LabSupervision,
) -> PreparedTrial:
    """Find the cells that become the robots of a trial; a `tetractl.spec.plants.Prepare`.

    Args:
        experiment: The experiment.
        clock: The clock of the trial.
        seed: Seed of the trial.
        supervision: How people supervise the run.

    Returns:
        The experiment with these cells as robots, and their plant.
    """
    plant = experiment.plant
    if isinstance(plant, RigSection):
        return _in_a_dish(plant, experiment, clock, seed, supervision)
    if not isinstance(plant, SimSection):
        raise UsageError(f"a plant of type {plant.type} has no robots to choose from")
    random = generator(seed, RandomStream.TRIAL_ROBOTS)
    cells = scattered_cells(choice_of(experiment), experiment.setup, random)
    chosen_experiment = settled(experiment, chosen_from(experiment, cells))
    return PreparedTrial(
        chosen_experiment, plant.build(chosen_experiment.setup, clock, seed, supervision)
    )


def _in_a_dish(
    lab: RigSection,
    experiment: Experiment,
    clock: Clock,
    seed: np.random.SeedSequence,
    supervision: LabSupervision,
) -> PreparedTrial:
    """Open the lab, and rotate the field to see how cells respond.

    The field keeps rotating until the first direction is sent.
    """
    rig = lab.rig(experiment.setup, clock, seed, supervision, chosen=True)
    rig.open()
    try:
        turned = int(seed.generate_state(1)[0])
        cells = turn_field(rig, choice_of(experiment), turned, supervision)
        chosen = chosen_from(experiment, cells)
        settled_experiment = settled(experiment, chosen)
        settle(rig, settled_experiment.setup, chosen)
        return PreparedTrial(settled_experiment, lab.plant(rig, supervision))
    except BaseException:
        rig.loop.stop()  # first, as the field turns until then, and a camera may close slowly
        rig.close()
        raise


def settle(rig: Rig, setup: Setup, cells: Sequence[RobotCandidate]) -> None:
    """Continue with cells as the robots of a setup, from where they are.

    Args:
        rig: The connected lab.
        setup: The constants of the experiment.
        cells: The cells.
    """
    if isinstance(rig.actuator, SettlesRobots):
        rig.actuator.settle(setup)
    tracker_of(rig).settle(setup, [cell.number for cell in cells])
    rig.settle(setup)
