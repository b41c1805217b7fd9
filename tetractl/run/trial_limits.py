"""The limits of an experiment, checks before a run, and the square of the paper's section IV-B.1.

On the square all robots get the same four directions, a quarter turn apart, each for the same time.
A robot whose heading starts a quarter turn behind the first direction follows the same curve on
every side, rotated by a quarter turn: the four displacements add up to zero, except for about
exp(-a side) of a side's length.
"""

import math
from collections.abc import Iterator

import numpy as np

from tetractl.core.errors import SpecError
from tetractl.core.poses import Floats
from tetractl.experiment.controller import Square
from tetractl.experiment.experiment import Experiment
from tetractl.model.motion.exact import step
from tetractl.model.path_check import PathCheck

SAMPLES = 64  # positions per side of a square that are checked against arena and obstacles


def limits(experiment: Experiment) -> dict[str, str]:
    """Return the limits of a trial by name, as text."""
    control = experiment.controller
    unit = experiment.units.length
    longest = control.time_limit
    fastest = max(robot.speed for robot in experiment.robots)
    limits = {
        "control period": f"{control.period:g} s",
        "duration of a trial": f"at most {longest:g} s after the first command",
        "path of a robot": f"at most {fastest * longest:g} {unit}",
    } | control.bounds()
    if isinstance(control.first_plan, Square):
        limits["before step 0"] = f"a square of {4 * control.first_plan.side:g} s"
    return limits | experiment.plant.bounds()


def check(experiment: Experiment) -> None:
    """Raise SpecError if robots would leave the arena or hit an obstacle before the first plan."""
    square = experiment.controller.first_plan
    if not isinstance(square, Square):
        return
    headings = experiment.setup.starts.heading
    if np.ptp(np.unwrap(np.sort(headings))) > 1e-6:
        raise SpecError(
            "controller.first_plan: a square needs all robots to start with the same heading",
            "give all robots the same heading, or use {type: stand}",
        )
    path = PathCheck.of(experiment.setup)
    setup = experiment.setup
    x = setup.starts.x
    y = setup.starts.y
    t = np.linspace(0, square.side, SAMPLES)[:, None]
    for direction in directions(headings):
        args = np.array(direction), setup.a, setup.speed, t
        path_x, path_y, turned = step(x, y, headings, *args)
        path.add(path_x, path_y)
        x = path_x[-1]
        y = path_y[-1]
        headings = turned[-1]
    for name, edge, entered in zip(setup.names, path.edge, path.entered, strict=True):
        if edge < 0 or entered:
            what = "leave the arena" if edge < 0 else "enter an obstacle"
            raise SpecError(
                f"controller.first_plan: robot {name} would {what} in its square",
                "shorten controller.first_plan.side, or use {type: stand}",
            )


def directions(headings: Floats) -> Iterator[float]:
    """Yield the four directions of a lap [rad] for robots with start headings (N,) [rad]."""
    sine = np.sin(headings).mean()
    cosine = np.cos(headings).mean()
    start = math.atan2(sine, cosine)
    for side in range(1, 5):
        yield math.remainder(start + side * math.pi / 2, 2 * math.pi)
