"""Generates random simulated cells, from which a trial chooses its robots."""

import numpy as np

from tetractl.core.poses import Pose
from tetractl.core.setup import Setup
from tetractl.model.cell_numbers import A_LOG_SD, SPEED_LOG_SD
from tetractl_microscope.choice.candidate import RobotCandidate
from tetractl_microscope.choice.section import Choice

CELLS_MIN = 6
"""Minimum number of simulated cells: a few more than most trials choose."""
SURVEY_RELATIVE_SD = 0.03
"""Relative standard deviation with which a survey measures a cell's turning rate a and speed."""
EDGE_FRACTION = 1 / 8
"""Width of the strip along each edge of the arena without cells, as a fraction of the arena."""


def generate_cells(
    choice: Choice, setup: Setup, random: np.random.Generator
) -> list[RobotCandidate]:
    """Generate random cells in the arena, with the errors with which a survey would measure them.

    Positions and headings are uniform. Turning rate a and speed are log-normal around the spec's
    typical values. The cells are numbered from 1.

    Args:
        choice: The spec's rule for choosing cells.
        setup: The constants of the experiment.
        random: The random generator.
    """
    arena = setup.arena
    count = max(CELLS_MIN, choice.choose)
    across = EDGE_FRACTION * arena.width
    edge_height = EDGE_FRACTION * arena.height
    # in this order: it is part of the result
    x = random.uniform(arena.left + across, arena.right - across, count)
    y = random.uniform(arena.bottom + edge_height, arena.top - edge_height, count)
    heading = random.uniform(-np.pi, np.pi, count)
    a = choice.a * np.exp(random.normal(0, A_LOG_SD, count))
    speed = choice.speed * np.exp(random.normal(0, SPEED_LOG_SD, count))
    poses = [Pose(*pose) for pose in np.column_stack([x, y, heading]).tolist()]
    cells = zip(poses, a.tolist(), speed.tolist(), strict=True)
    return [
        RobotCandidate(
            number=number,
            pose=pose,
            a=a_of_cell,
            a_sd=SURVEY_RELATIVE_SD * a_of_cell,
            speed=speed_of_cell,
            speed_sd=SURVEY_RELATIVE_SD * speed_of_cell,
        )
        for number, (pose, a_of_cell, speed_of_cell) in enumerate(cells, 1)
    ]
