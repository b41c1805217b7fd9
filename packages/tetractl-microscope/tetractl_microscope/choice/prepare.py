"""Chooses the robots of a trial among the cells of a dish, real or simulated."""

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
from tetractl_microscope.choice.choosing import choose_cells, set_robots
from tetractl_microscope.choice.dish_abilities import SettlesRobots, require_cell_tracker
from tetractl_microscope.choice.scattered_cells import generate_cells
from tetractl_microscope.choice.section import require_choice
from tetractl_microscope.choice.turn_field import turn_field


def prepare(
    experiment: Experiment,
    clock: Clock,
    seed: np.random.SeedSequence,
    supervision: LabSupervision,
) -> PreparedTrial:
    """Choose cells as the robots of a trial, and create the plant with these robots.

    In the lab, the field rotates and the camera measures how each cell responds. In a simulation,
    the cells are generated at random. The function has the type `tetractl.spec.plants.Prepare`.

    Args:
        experiment: The experiment, whose spec has `robots: {choose: N}`.
        clock: The clock of the trial.
        seed: Seed of the trial.
        supervision: Prompts for the operator, and the ways in which the operator can cancel or stop
            the run. Used in the lab only.

    Returns:
        The experiment with the chosen cells as its robots, and the plant that moves them.

    Raises:
        UsageError: If the experiment's plant has no cells to choose from.
        AbortError: If too few cells respond to the field, or the lab fails.
    """
    plant = experiment.plant
    if isinstance(plant, RigSection):
        return _choose_in_lab(plant, experiment, clock, seed, supervision)
    if not isinstance(plant, SimSection):
        raise UsageError(f"a plant of type {plant.type} has no cells to choose the robots from")
    random = generator(seed, RandomStream.TRIAL_ROBOTS)
    cells = generate_cells(require_choice(experiment), experiment.setup, random)
    chosen_experiment = set_robots(experiment, choose_cells(experiment, cells))
    return PreparedTrial(
        chosen_experiment, plant.build(chosen_experiment.setup, clock, seed, supervision)
    )


def _choose_in_lab(
    lab: RigSection,
    experiment: Experiment,
    clock: Clock,
    seed: np.random.SeedSequence,
    supervision: LabSupervision,
) -> PreparedTrial:
    """Open a lab, rotate the field to measure how cells respond, and choose the robots.

    The field keeps rotating until the first direction is sent. After an error, the lab is closed.
    """
    rig = lab.rig(experiment.setup, clock, seed, supervision, chosen=True)
    rig.open()
    try:
        turned = int(seed.generate_state(1)[0])
        cells = turn_field(rig, require_choice(experiment), turned, supervision)
        chosen = choose_cells(experiment, cells)
        settled_experiment = set_robots(experiment, chosen)
        settle(rig, settled_experiment.setup, chosen)
        return PreparedTrial(settled_experiment, lab.plant(rig, supervision))
    except BaseException:
        rig.loop.stop()  # first, as the field turns until then, and a camera may close slowly
        rig.close()
        raise


def settle(rig: Rig, setup: Setup, cells: Sequence[RobotCandidate]) -> None:
    """Tell the devices of a lab which cells are the robots of the trial.

    Args:
        rig: The connected lab.
        setup: The constants of the experiment with the chosen robots.
        cells: The chosen cells, in the order of the setup's robots.
    """
    if isinstance(rig.actuator, SettlesRobots):
        rig.actuator.settle(setup)
    require_cell_tracker(rig).settle(setup, [cell.number for cell in cells])
    rig.settle(setup)
