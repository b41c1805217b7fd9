"""Rules for choosing which cells of a dish become the robots of a trial."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from tetractl.core.errors import AbortError
from tetractl.core.poses import Floats
from tetractl.core.setup import Setup
from tetractl.spec.experiment import Experiment, Robot, assign_targets
from tetractl_microscope.choice.candidate import RobotCandidate
from tetractl_microscope.choice.section import Choice, require_choice

# Maximum difference of ln a of two robots that makes a choice better.
DISSIMILARITY_MAX = 0.4
# Maximum difference of ln a or ln speed at which a cell can be the wanted one.
LOG_DIFFERENCE_MAX = 0.3


def choose_cells(experiment: Experiment, cells: Sequence[RobotCandidate]) -> list[RobotCandidate]:
    """Choose the cells that become the robots of a trial.

    Only the 14 cells with the largest turning rates among those that respond to the field are
    considered.

    Args:
        experiment: An experiment whose spec has `robots: {choose: N}`.
        cells: All cells that were measured.

    Returns:
        The chosen cells. They are the cells that a survey proposed (`wanted`) or else the best
        choice according to `rate_choice`, in the order of decreasing turning rate.

    Raises:
        AbortError: If too few cells respond to the field, or if a wanted cell is missing.
    """
    choice = require_choice(experiment)
    responding_cells = [cell for cell in cells if cell.magnetised]
    if len(responding_cells) < choice.choose:
        raise AbortError(
            f"only {len(responding_cells)} of {len(cells)} cells respond to the field, but "
            f"{choice.choose} are needed",
            "use more cells or a stronger field, or choose fewer robots in the spec",
        )
    responding_cells = sorted(responding_cells, key=lambda cell: -cell.a)[
        :14
    ]  # more would have very many combinations
    if choice.wanted:
        return _find_wanted_cells(choice, responding_cells)
    combinations_of_cells = combinations(responding_cells, choice.choose)
    return list(
        max(combinations_of_cells, key=lambda cells_chosen: rate_choice(cells_chosen, experiment))
    )


def set_robots(experiment: Experiment, cells: Sequence[RobotCandidate]) -> Experiment:
    """Return a copy of an experiment with the chosen cells as its robots.

    The robots start at the cells' poses. Targets are assigned so that the sum of the squared
    distances from start to target is minimal.

    Args:
        experiment: An experiment whose spec has `robots: {choose: N}`.
        cells: The chosen cells.
    """
    choice = require_choice(experiment)
    places = np.array([(cell.pose.x, cell.pose.y) for cell in cells])
    goals = choice.goals
    robots = [
        Robot(
            name=f"cell {i}",
            start=(cell.pose.x, cell.pose.y),
            heading=cell.pose.heading,
            target=tuple(goals[goal].tolist()),
            a=cell.a,
            speed=cell.speed,
        )
        for i, (cell, goal) in enumerate(zip(cells, assign_targets(places, goals), strict=True), 1)
    ]
    chosen = choice.model_copy(update={"found": True})
    copied = experiment.model_copy(update={"robots": tuple(robots), "chosen": chosen})
    vars(copied).pop("setup", None)  # the cached setup belongs to the placeholder robots
    return copied


def compute_dissimilarity(a: Floats, a_sd: Floats) -> float:
    """Compute how different the turning rates of cells are, so that one field can steer them apart.

    Args:
        a: Turning rates, shape (N,) [rad/s].
        a_sd: Their standard deviations, shape (N,) [rad/s].

    Returns:
        The minimum of |ln a_i - ln a_j|, minus the standard deviation of this difference, over
        cells that are neighbours in the order of turning rates. It is inf for a single cell.
    """
    order = np.argsort(a)
    log_rates = np.log(a[order])
    log_sd = a_sd[order] / a[order]  # of the logarithms
    difference_sd = np.hypot(log_sd[1:], log_sd[:-1])
    return float(np.min(np.diff(log_rates) - difference_sd, initial=np.inf))


def rate_choice(
    cells: Sequence[RobotCandidate], experiment: Experiment
) -> tuple[bool, float, float]:
    """Rate a choice of cells: the larger the result, the better the choice.

    Args:
        cells: The cells of the choice.
        experiment: The experiment.

    Returns:
        A tuple, to be compared with the tuples of other choices. Its entries are: whether all cells
        are free and stay clear of walls for 0.5 s, their `compute_dissimilarity` up to
        DISSIMILARITY_MAX, and their minimum turning rate [rad/s].
    """
    arena = experiment.setup.arena
    x, y = np.array([(cell.pose.x, cell.pose.y) for cell in cells]).T
    speed = np.array([cell.speed for cell in cells])
    # cells that could swim to the arena's edge within half a second are chosen last
    stays_inside = bool((arena.depth_inside(x, y) > 0.5 * speed).all())
    are_all_free = stays_inside and all(cell.free for cell in cells)
    a = np.array([cell.a for cell in cells])
    dissimilarity = compute_dissimilarity(a, np.array([cell.a_sd for cell in cells]))
    return are_all_free, min(dissimilarity, DISSIMILARITY_MAX), float(a.min())


def find_most_similar(
    setup: Setup, robot: int, cells: Sequence[RobotCandidate]
) -> RobotCandidate | None:
    """Find the cell that is most similar to a robot in turning rate and speed.

    Args:
        setup: The constants of the experiment.
        robot: Index of the robot.
        cells: The cells to choose from.

    Returns:
        The cell, or None if no cell is similar: ln a or ln speed differs by more than
            LOG_DIFFERENCE_MAX.
    """
    if not cells:
        return None
    log_robot = np.log([setup.a[robot], setup.speed[robot]])
    log_cells = np.log([(cell.a, cell.speed) for cell in cells])
    log_differences = np.abs(log_cells - log_robot).max(axis=1)
    best = int(log_differences.argmin())
    return None if log_differences[best] > LOG_DIFFERENCE_MAX else cells[best]


def _find_wanted_cells(choice: Choice, cells: Sequence[RobotCandidate]) -> list[RobotCandidate]:
    """Find the cells that a survey proposed again, by their turning rates and speeds.

    Raises:
        AbortError: If a wanted cell is not found.
    """
    log_wanted = np.log([(cell.a, cell.speed) for cell in choice.wanted])
    log_cells = np.log([(cell.a, cell.speed) for cell in cells])
    cell_indices = assign_targets(log_wanted, log_cells)
    for log_pair, i in zip(log_wanted, cell_indices, strict=True):
        if np.abs(log_pair - log_cells[i]).max() > LOG_DIFFERENCE_MAX:
            a, speed = np.exp(log_pair)
            raise AbortError(
                f"the cell with turning rate {a:.2f} rad/s and speed {speed:.0f} length units/s "
                "was not found again",
                "survey the dish again with `tetractl lab survey`",
            )
    return [cells[i] for i in cell_indices]
